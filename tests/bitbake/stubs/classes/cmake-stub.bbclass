# What the classes of meta-ros do: configure, build and install a package, by Debian's cross compiler. A test may name another
# compiler's options, and a shell file that sets up this machine's ROS 2, in stub_compiler and stub_setup.
# Where a package goes, and what it may find there, are the caller's: stub_prefix.
DEPENDS ?= ""
EXTRA_OECMAKE ?= ""

stub_setup ?= ":"
stub_compiler ?= "-DCMAKE_TOOLCHAIN_FILE=${TOOLCHAIN_FILE} -DMETA_SYSROOT=${SYSROOT} -DMETA_WORK=${TMPDIR} \
    -DMETA_TRIPLET=arm-linux-gnueabihf -DMETA_PROCESSOR=armv7l -DPYTHON_EXECUTABLE=${BUILD_PYTHON}"

# The name of the build folder changes with every test; ccache has to ignore it.
export CCACHE_BASEDIR = "${TMPDIR}"
export CCACHE_NOHASHDIR = "1"

do_configure() {
    ${stub_setup}
    cmake -G Ninja -S ${S} -B ${B} -DCMAKE_CXX_COMPILER_LAUNCHER=ccache ${stub_compiler} \
        -DCMAKE_PREFIX_PATH="${STAGE}${stub_prefix};$AMENT_PREFIX_PATH" -DCMAKE_INSTALL_PREFIX=${stub_prefix} \
        -DCMAKE_BUILD_TYPE=None -DCMAKE_CXX_FLAGS=-O0 ${EXTRA_OECMAKE}
}

do_compile() {
    ${stub_setup}
    cmake --build ${B}
}

do_install() {
    DESTDIR=${D} cmake --build ${B} --target install
    # Stands for do_populate_sysroot: the next package finds this one.
    mkdir -p ${STAGE}
    cp -r ${D}/. ${STAGE}
}
