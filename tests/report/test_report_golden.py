"""Each form of the example report, byte by byte.

After an intended change write the files anew with ``pytest tests/report --update-golden`` and look at the diff.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from example_report import empty, example, healed, sound

from vhp_cli.report import FORMATS, render

GOLDEN = Path(__file__).parent / "golden"
SUFFIXES = {
    "table": "txt",
    "json": "json",
    "jsonl": "jsonl",
    "csv": "csv",
    "markdown": "md",
    "junit": "xml",
    "sarif": "sarif",
    "github": "github.txt",
}


def compare(name: str, text: str, request: pytest.FixtureRequest) -> None:
    path = GOLDEN / name
    if request.config.getoption("--update-golden"):
        path.write_bytes(text.encode())
    assert path.read_bytes().decode() == text


@pytest.mark.parametrize("form", FORMATS)
def test_golden(form: str, request: pytest.FixtureRequest) -> None:
    compare(f"example.{SUFFIXES[form]}", render(example(), form, base="model/"), request)


@pytest.mark.parametrize("form", FORMATS)
def test_golden_stage(form: str, request: pytest.FixtureRequest) -> None:
    compare(f"healed.{SUFFIXES[form]}", render(healed(), form, base="out/"), request)


def test_golden_stage_narrow_and_verbose(request: pytest.FixtureRequest) -> None:
    compare("healed-80.txt", render(healed(), "table", width=80), request)
    compare("healed-verbose.txt", render(healed(), "table", width=120, verbose=True), request)


def test_golden_narrow_table(request: pytest.FixtureRequest) -> None:
    compare("example-80.txt", render(example(), "table", width=80), request)


def test_golden_verbose_table(request: pytest.FixtureRequest) -> None:
    compare("example-verbose.txt", render(example(), "table", width=120, verbose=True), request)


@pytest.mark.parametrize("form", FORMATS)
def test_golden_sound(form: str, request: pytest.FixtureRequest) -> None:
    if form in ("table", "markdown", "junit", "github"):
        compare(f"sound.{SUFFIXES[form]}", render(sound(), form), request)


@pytest.mark.parametrize("form", FORMATS)
def test_a_report_without_tissues_can_be_written(form: str) -> None:
    assert render(empty(), form).endswith("\n")


@pytest.mark.parametrize("form", FORMATS)
def test_same_report_same_bytes_whatever_the_order_of_keys(form: str) -> None:
    def reverse(value: object) -> object:
        if isinstance(value, dict):
            return {key: reverse(value[key]) for key in reversed(value)}
        return [reverse(item) for item in value] if isinstance(value, list) else value

    reversed_report = reverse(example())
    # The nesting is shown in the order of the report.
    reversed_report["nesting"] = example()["nesting"]  # type: ignore[index]
    assert render(reversed_report, form) == render(example(), form)  # type: ignore[arg-type]
