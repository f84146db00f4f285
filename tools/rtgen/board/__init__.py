"""The emulated board: an ARM board in QEMU made of Debian's packages, and the sysroot of its programs."""
