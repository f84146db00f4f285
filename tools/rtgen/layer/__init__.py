"""The BitBake layer: facts of each Yocto release (data), and the files rendered from a profile."""
