# Compile with Debian's compiler of an architecture (META_TRIPLET, META_PROCESSOR) against a sysroot of its packages
# (META_SYSROOT); the message generators run on this machine.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR "${META_PROCESSOR}")
set(CMAKE_C_COMPILER "${META_TRIPLET}-gcc")
set(CMAKE_CXX_COMPILER "${META_TRIPLET}-g++")
set(CMAKE_LIBRARY_ARCHITECTURE "${META_TRIPLET}")

set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES META_TRIPLET META_PROCESSOR META_SYSROOT META_WORK)
set(CMAKE_SYSROOT "${META_SYSROOT}")
# Debian's cross compilers look for the C and C++ library in their own folders before the sysroot, where they may be those
# of another release than the libraries of the sysroot need.
file(GLOB META_LIBRARIES "${META_SYSROOT}/usr/lib/gcc/${META_TRIPLET}/*" "${META_SYSROOT}/usr/lib/${META_TRIPLET}")
list(TRANSFORM META_LIBRARIES PREPEND "-L")
list(JOIN META_LIBRARIES " " CMAKE_EXE_LINKER_FLAGS_INIT)
# CMake finds the packages of this build in its working folder and all others in the sysroot. The absolute paths in Debian's
# CMake files would otherwise lead to /usr of this machine.
set(CMAKE_FIND_ROOT_PATH "${META_WORK}" "${META_SYSROOT}")
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
