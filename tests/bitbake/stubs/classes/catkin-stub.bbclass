# What the catkin classes of meta-ros do, with Debian's cross compiler: configure, build and install a catkin package.
# Where a package goes, and what it may find there, are the caller's: catkin_prefix.
DEPENDS ?= ""

do_configure() {
    export CCACHE_BASEDIR=${TMPDIR} CCACHE_NOHASHDIR=1
    cmake -G Ninja -S ${S} -B ${B} -DCMAKE_CXX_COMPILER_LAUNCHER=ccache \
        -DCMAKE_TOOLCHAIN_FILE=${TOOLCHAIN_FILE} -DMETA_SYSROOT=${SYSROOT} -DMETA_WORK=${TMPDIR} \
        -DMETA_TRIPLET=arm-linux-gnueabihf -DMETA_PROCESSOR=armv7l \
        -DCMAKE_PREFIX_PATH=${STAGE}${catkin_prefix} -DCMAKE_INSTALL_PREFIX=${catkin_prefix} \
        -DCATKIN_BUILD_BINARY_PACKAGE=ON -DCATKIN_ENABLE_TESTING=0 -DPYTHON_EXECUTABLE=${BUILD_PYTHON} \
        -DCMAKE_BUILD_TYPE=None -DCMAKE_CXX_FLAGS=-O0
}

do_compile() {
    cmake --build ${B}
}

do_install() {
    DESTDIR=${D} cmake --build ${B} --target install
    # Stands for do_populate_sysroot: the next package finds this one.
    mkdir -p ${STAGE}
    cp -r ${D}/. ${STAGE}
}
