"""How Sphinx builds the documentation: `make docs`, or rosdoc2."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "_ext"), str(DOCS.parent)]

# Printed commands say how they were found: here as a reader finds them.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

project = "valve_sim"
author = "valve_sim maintainers"
copyright = "valve_sim maintainers, Apache-2.0"
# rosdoc2 builds a copy of this folder, and knows the version itself.
if (DOCS.parent / "package.xml").is_file():
    release = version = ElementTree.parse(DOCS.parent / "package.xml").findtext("version", "")

# What has no rosdep key may be missing where rosdoc2 runs: then notebook, command line or formulas are plainer.
has = {name: find_spec(name) is not None for name in ("furo", "latex2mathml", "myst_nb", "sphinx_click")}
extensions = [
    "myst_nb" if has["myst_nb"] else "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "plain_docstrings",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    *(["sphinx_click"] if has["sphinx_click"] else []),
    *(["mathml"] if has["latex2mathml"] else ["sphinx.ext.mathjax"]),
]
exclude_patterns = ["_build", "_ext", "_templates", "examples"]
templates_path = ["_templates"]
default_role = "code"
# A field that several classes have, such as `name`, is no one's link.
suppress_warnings = ["ref.python"]

html_math_renderer = "mathml" if has["latex2mathml"] else "mathjax"

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 4
# The notebook is executed while the site is built, wherever that can be done.
nb_execution_mode = "force" if all(map(find_spec, ["llvmlite", "ipykernel", "rosbags"])) else "off"
nb_execution_timeout = -1  # a busy machine takes its time
nb_execution_raise_on_error = True
nb_merge_streams = True

autosummary_generate = True
# What needs an extra is documented where that is missing, too.
_EXTRAS = ("aiosqlite", "asyncua", "cryptography", "pymodbus", "pythonfmu")
autodoc_mock_imports = [name for name in _EXTRAS if find_spec(name) is None]
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_use_type_comments = False  # there are none, and each source would be read again for them
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Mask", "Progress", "Rewrite", "Term")}
maximum_signature_line_length = 88
python_use_unqualified_type_names = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False  # the signature has the types
napoleon_use_rtype = False

html_theme = "furo" if has["furo"] else "alabaster"
html_title = "valve_sim"
html_static_path = ["_static"]
html_css_files = ["valve_sim.css"]
html_copy_source = False
html_show_sphinx = False

rosdoc2_settings = {"override_theme": not has["furo"], "enable_autodoc": True, "support_markdown": False}
