"""The sub-commands of rtgen, one module each; they parse and print, other modules do the work."""

# Here and not in rtgen.profile, which imports slowly: `--help` prints it.
DEFAULT_PROFILE = "scarthgap-noetic"
