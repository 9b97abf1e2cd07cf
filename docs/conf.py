"""Sphinx configuration: MyST pages, numpydoc reference, a theme that needs no network."""

import re
import sys
import tempfile
import textwrap
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import gallery  # noqa: E402
import generated  # noqa: E402

from robust_filterpy import __version__  # noqa: E402

project = "robust_filterpy"
author = "the robust_filterpy developers"
copyright = author
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc"]
# The pages of situations draw their figures when the site is built; a page that has not changed keeps them.
extensions += ["matplotlib.sphinxext.plot_directive"]
plot_formats = [("png", 130)]
plot_html_show_formats = plot_html_show_source_link = False
# Small, so that the words in it can be read on a telephone too.
plot_rcparams = {"figure.figsize": (5.5, 3.6), "font.size": 9, "legend.fontsize": 7.5, "legend.title_fontsize": 7.5}
plot_rcparams["figure.constrained_layout.use"] = True
plot_apply_rcparams = True
plot_working_directory = tempfile.mkdtemp()
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

# Equations are no Python; programs name their language.
highlight_language = "none"
# A word in single backticks is code; what can be linked is linked by the tables of each page.
default_role = "code"
# Docstrings write the length of e as |e|, which reStructuredText takes for a substitution.
rst_prolog = "\n".join(f".. |{name}| replace:: \\|{name}\\|" for name in ("e", "u"))
autosummary_generate = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
# In the list of what is on the page a method's class goes without saying, and would break in a word.
toc_object_entries_show_parents = "hide"
# What filterpy documents is not repeated.
autodoc_inherit_docstrings = False
numpydoc_show_class_members = False

# "See also" names functions of single modules that have no page, and one of scipy.
nitpick_ignore_regex = [("py:obj", r"robust_filterpy\.correction\.\w+\.\w+|rv_discrete\.ppf")]

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"robust_filterpy {__version__}"
html_show_copyright = False
html_copy_source = False


def with_figures(app, name, source):
    """Let the site run the cells of a tutorial one after the other and show what they draw."""
    if name.startswith("tutorial/"):
        contexts = iter(["reset"])

        def cell(match):
            options = f"   :context: {next(contexts, 'close-figs')}\n   :include-source:\n"
            return "```{eval-rst}\n.. plot::\n" + options + "\n" + textwrap.indent(match[1], "   ") + "```"

        title, _, rest = re.sub(r"(?ms)^```python\n(.*?)```$", cell, source[0]).partition("\n")
        notebook = f"{name.rpartition('/')[2]}.ipynb"
        source[0] = f"{title}\n\nAs a notebook: {{download}}`{notebook} <../examples/notebooks/{notebook}>`.\n{rest}"


def setup(app):
    """Write the reference and the pages of the examples before Sphinx looks for pages."""
    app.connect("source-read", with_figures)

    def write(_):
        generated.write(HERE, {**generated.api_pages(), **gallery.pages(HERE.parent / "examples", HERE)})

    app.connect("builder-inited", write)
