"""The site of these pages: `make docs` builds it, strictly. Pages are CommonMark, which a forge shows without it."""

project = "meta-rt-tests"
extensions = ["myst_parser"]
myst_heading_anchors = 4  # links to headings are those that a forge makes
highlight_language = "text"  # indented blocks are of the shell, of YAML and of printed tables alike
nitpicky = True
smartquotes = False  # -- is an option here

html_theme = "furo"
html_title = project
html_copy_source = False
html_static_path = html_css_files = ["site.css"]
html_use_index = False  # nothing is in it
html_show_copyright = False
html_show_sphinx = False
