"""The emulated board: an ARM board in QEMU made from Debian packages, and the sysroot for its programs."""
