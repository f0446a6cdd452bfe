"""Time and size of the page of a report: ``python benchmarks/page.py``.

Phantoms with planted defects are checked, and the page is made and opened in headless Chromium without a graphics
card, where Playwright and Chromium are installed. CPU time is that of this process.
"""

from __future__ import annotations

import argparse
import importlib.util
import statistics
import sys
import time
from pathlib import Path

import models

sys.path.insert(0, str(models.REPOSITORY))
sys.path.insert(0, str(models.REPOSITORY / "tests"))

from check import table

from vhp_cli.cli import main as vhp
from vhp_cli.config import load_settings
from vhp_cli.model import find_model
from vhp_cli.pipeline.check import check_model
from vhp_cli.pipeline.surfaces import surfaces_of
from vhp_cli.report.html import html_page

WORK = models.CACHE / "page"
MODELS = {"30 tissues": (30, 20_000), "91 tissues": (91, 700_000), "282 tissues": (282, 700_000)}
OPENED = 3


def page_row(name: str, tissues: int, triangles: int) -> dict[str, str]:
    """Make the page of a phantom and open it a few times."""
    directory = WORK / f"{tissues}-{triangles}"
    if not directory.is_dir():
        arguments = ["--tissues", str(tissues), "--triangles", str(triangles), "--defects", "7"]
        if vhp(["phantom", str(directory), *arguments]):
            raise SystemExit("the phantom could not be made")
    report = check_model(find_model([directory]), load_settings(model=[directory]), paths=[directory]).report
    before = time.process_time()
    text = html_page(report, surfaces_of(report, f"{directory}/"))
    spent = time.process_time() - before
    page = WORK / f"{tissues}-{triangles}.html"
    page.write_text(text, encoding="utf-8")
    return {
        "model": name,
        "triangles": f"{report['summary']['triangles']:,}",
        "page (MB)": f"{len(text.encode()) / 1e6:.1f}",
        "made in (s of CPU)": f"{spent:.1f}",
        "first view (s)": first_view(page),
    }


def first_view(page: Path) -> str:
    """Return the median time from the start of loading to the first picture of the model."""
    if importlib.util.find_spec("playwright") is None:
        return "-"
    import browser

    if browser.CHROMIUM is None:
        return "-"
    times = []
    for _ in range(OPENED):
        with browser.page_of(page, size=(1600, 950)) as (opened, said):
            opened.wait_for_function("window.vhp && (vhp.ready || vhp.failed)", timeout=120_000)
            if said or opened.evaluate("vhp.failed"):
                raise SystemExit(f"{page}: {said or opened.evaluate('vhp.failed')}")
            times.append(opened.evaluate("vhp.firstView") / 1000)
    return f"{statistics.median(times):.1f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=list(MODELS), help="one of the models")
    chosen = parser.parse_args().only
    WORK.mkdir(parents=True, exist_ok=True)
    rows = [page_row(name, *size) for name, size in MODELS.items() if chosen in (None, name)]
    print(table(list(rows[0]), [list(row.values()) for row in rows]))


if __name__ == "__main__":
    main()
