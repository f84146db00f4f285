"""The sub-commands of rtrun, one module each; they parse and print, other modules do the work."""
