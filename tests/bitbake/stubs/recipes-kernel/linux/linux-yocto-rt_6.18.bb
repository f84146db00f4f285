require stub-kernel.inc
