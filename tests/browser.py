"""Pages in a real browser: headless Chromium, driven by Playwright. Tests skip where either is missing."""

from __future__ import annotations

import atexit
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
# Drawn by the processor, so that it works on a machine without a graphics card.
SOFTWARE = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
WITHOUT_WEBGL = ("--no-sandbox", "--disable-gpu", "--disable-3d-apis")


@cache
def _driver() -> Any:
    """Start Playwright: once in a process, as two can't run in one thread."""
    started = pytest.importorskip("playwright.sync_api").sync_playwright().start()
    atexit.register(started.stop)
    return started


@contextmanager
def page_of(
    path: Path,
    *,
    scheme: str = "light",
    size: tuple[int, int] = (1100, 720),
    reduced_motion: bool = True,
    arguments: tuple[str, ...] = SOFTWARE,
) -> Iterator[tuple[Any, list[str]]]:
    """Open a file; give the page of Playwright, and a list that takes every error, warning and request it makes."""
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    said: list[str] = []
    browser = _driver().chromium.launch(executable_path=CHROMIUM, args=list(arguments))
    try:
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]},
            color_scheme=scheme,
            reduced_motion="reduce" if reduced_motion else "no-preference",
        )
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text) if message.type in ("error", "warning") else 0)
        page.on("pageerror", lambda error: said.append(str(error)))
        address = path.resolve().as_uri()
        page.on(
            "request",
            lambda request: (
                said.append(f"asks for {request.url[:100]}")
                if request.url != address and not request.url.startswith(("data:", "blob:"))
                else 0
            ),
        )
        page.goto(address)
        yield page, said
    finally:
        browser.close()
