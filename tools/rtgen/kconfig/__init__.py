"""Kernel options as data, rendered into fragments and verified with a real kernel tree.

`data` reads ``kconfig/*.yml``, `render` makes a fragment from it, `fragment` reads config files, `tree` is a kernel
tree with its own ``conf``, `verify` compares the result of ``conf`` with a fragment, `explain` explains why an option
does not hold, and `debian_source` downloads the tree that the fragments are verified on.
"""
