IMAGE_ROOTFS = "${WORKDIR}/rootfs"
CORE_IMAGE_EXTRA_INSTALL ?= ""
ROOTFS_POSTPROCESS_COMMAND ?= ""
do_rootfs[dirs] = "${IMAGE_ROOTFS}"
do_rootfs() {
    :
}
addtask rootfs
