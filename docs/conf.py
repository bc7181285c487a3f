# SPDX-License-Identifier: GPL-3.0-or-later
"""The documents as a site: `sphinx-build docs FOLDER`, without a network. Schemas and manual pages are made from the code."""

import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
PACKAGE = Path(os.environ.get("CAST_BUILD", HERE.parent / "build")) / "python"
sys.path.insert(0, str(PACKAGE))
os.environ["PYTHONPATH"] = os.pathsep.join([str(PACKAGE), *filter(None, [os.environ.get("PYTHONPATH")])])  # of notebooks, too
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only wait for each other
from gr_cast import __version__

project, author, copyright = "gr-cast", "gr-cast contributors", "gr-cast contributors, GPL-3.0-or-later"
version = release = __version__
extensions = ["myst_parser", "nbsphinx", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "examples", "made"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
nbsphinx_execute = "always"
nbsphinx_timeout = 300
html_theme = "alabaster"
html_theme_options = {"description": "Wireless digital twins with GNU Radio", "fixed_sidebar": True, "page_width": "1100px"}
html_extra_path = ["made"]  # the schemas, as they are
highlight_language = "none"
suppress_warnings = ["myst.header"]  # pages that begin with a picture

subprocess.run([sys.executable, HERE / "schemas.py", HERE / "made" / "schemas"], check=True)
