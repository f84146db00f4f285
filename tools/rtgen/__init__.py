"""Generators: profiles, layer, kernel options, and the emulated board that needs no hardware."""
