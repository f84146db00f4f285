"""Shared by ``rtgen`` and ``rtrun``: typed input with limits, output, atomic writes, the build cache, commands.

It imports neither of them.
"""
