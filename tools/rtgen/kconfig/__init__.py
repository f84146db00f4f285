"""Kernel options as data: loaded, rendered into fragments, and proved against a real kernel tree.

`data` reads ``kconfig/*.yml``, `render` makes a fragment of it, `fragment` reads config files, `tree` is a kernel tree
with its own ``conf``, `verify` compares what ``conf`` made of a fragment, `explain` says why a line did not hold, and
`debian_source` brings the tree that the project is proved against.
"""
