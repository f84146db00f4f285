"""Generators: profiles, layer, kernel options, and the rehearsal board that needs no hardware."""
