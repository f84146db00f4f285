"""The sub-commands of rtrun, one module each; they parse and print, the work is done elsewhere."""
