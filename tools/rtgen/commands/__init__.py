"""The sub-commands of rtgen, one module each; they parse and print, the work is done elsewhere."""

# Here and not in rtgen.profile, which takes long to import: `--help` prints it.
DEFAULT_PROFILE = "scarthgap-noetic"
