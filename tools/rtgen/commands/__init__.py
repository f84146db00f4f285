"""The sub-commands of rtgen, one module each; they parse and print, the work is done elsewhere."""
