"""The report as one page for a browser: tables, pictures, and a viewer that leads to each finding."""

from vhp_cli.report.html.page import html_page
from vhp_cli.report.html.shown import Shown, Surfaces

__all__ = ["Shown", "Surfaces", "html_page"]
