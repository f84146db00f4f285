# What a recipe without ROS inherits. FILES as bitbake.conf of openembedded-core has them, as far as they concern our files:
# a folder of lib or share belongs to a package only where it has the recipe's name.
stub_prefix = "${prefix}"
inherit cmake-stub
FILES:${PN}-dbg = "${libdir}/*/.debug"
FILES:${PN}-staticdev = "${libdir}/*.a"
FILES:${PN}-dev = "${includedir} ${libdir}/pkgconfig ${libdir}/cmake ${datadir}/cmake"
FILES:${PN} = "${bindir} ${libdir}/lib*.so.* ${libdir}/${BPN} ${datadir}/${BPN}"
