"""The BitBake layer: what each Yocto release expects (data), and the files rendered from a profile."""
