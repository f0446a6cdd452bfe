from __future__ import annotations

import io

import pytest
from example_report import build, example, finding, many, pair, renamed, sound, tissue
from rich.cells import cell_len
from rich.console import Console

from vhp_cli.measures import Report
from vhp_cli.report import print_table, render
from vhp_cli.report.table import nesting_tree
from vhp_cli.report.text import number, place, plural
from vhp_cli.report.verdict import by_rule, closing_line, judge, seconds


@pytest.mark.parametrize("width", [60, 80, 100, 120])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    long_names = renamed("VHP_" + "x" * 70, "VHP Peripheral Nerve of a very long name indeed left")
    for report in (example(), long_names, many(60)):
        for verbose in (False, True):
            lines = render(report, "table", width=width, verbose=verbose).splitlines()
            assert max(map(cell_len, lines)) <= width


def test_the_table_repeats_the_columns_of_the_thesis() -> None:
    lines = render(example(), "table", width=120).splitlines()
    assert " ".join(lines[0].split()) == "No Tissue Triangles Mesh quality Min. edge length (mm) Tissue type Verdict"
    row = next(line for line in lines if "Median" in line)
    assert " ".join(row.split()) == "2 VHP Median Nerve left 520 7.14e-07 0.000393 nerve 1 error T001"


def test_names_are_no_markup_and_move_no_cursor() -> None:
    text = render(renamed("[bold red]a[/bold red]", "b\x1b[2J\nc"), "table", width=200)
    assert "[bold red]a[/bold red]" in text
    assert "b\\x1b[2J\\nc" in text
    assert "\x1b" not in text


def test_a_long_model_shows_only_tissues_with_findings() -> None:
    text = render(many(300), "table", width=100)
    rows = [line for line in text.splitlines() if "error T001" in line and "organ" in line]
    assert len(rows) == 30
    assert rows[1].split()[:3] == ["11", "Tissue", "010"]
    assert "270 other tissues passed" in text
    assert "... and 26 more (--verbose)" in text
    full = render(many(300), "table", width=100, verbose=True)
    assert sum("organ" in line for line in full.splitlines()) == 300
    assert "other tissues" not in full
    assert len(text.splitlines()) < 60


def test_a_long_model_shows_tissues_with_warnings_too() -> None:
    report = many(50)
    report["findings"].append(finding("F010", ["Tissue 007"]))
    text = render(report, "table")
    assert [line.split()[2] for line in text.splitlines() if " organ " in line][:2] == ["000", "007"]
    assert "44 other tissues passed" in text


def test_a_long_sound_model_has_no_empty_table() -> None:
    report = many(50)
    report["findings"] = []
    for record in report["tissues"]:
        record["findings"] = []
    text = render(report, "table")
    assert text.startswith("50 tissues passed")


def test_the_worst_rule_comes_first_and_within_it_the_most_occurrences() -> None:
    findings = [
        finding("T007", ["a"], 50),
        finding("X001", ["a"], 2),
        finding("X001", ["b"], 7),
        finding("T001", ["c"], 1, known=True),
        finding("X005", ["a"], 9),
        finding("F001", ["c"], 1),
    ]
    grouped = by_rule(findings)
    assert [code for code, _ in grouped] == ["F001", "X001", "X005", "T007", "T001"]
    assert [item["count"] for item in grouped[1][1]] == [7, 2]


def test_nesting_survives_cycles_unknown_parents_and_depth() -> None:
    chain: dict[str, str | None] = {"t0": None, **{f"t{no}": f"t{no - 1}" for no in range(1, 2000)}}
    for nesting in ({"a": "b", "b": "a", "c": "gone", "d": "d"}, chain):
        tree = nesting_tree(nesting)
        names, stack = [], [tree]
        while stack:
            node = stack.pop()
            names.append(str(node.label))
            stack += node.children
        assert sorted(names) == sorted(["Nesting", *nesting])


def test_colours_follow_the_console() -> None:
    def printed(report: Report, **options: object) -> str:
        console = Console(file=io.StringIO(), width=100, force_terminal=True, color_system="standard", **options)  # type: ignore[arg-type]
        print_table(report, console)
        return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]

    assert "\x1b[1;31mfailed" in printed(example())
    assert "\x1b[1;32mpassed" in printed(sound())
    assert "\x1b[1;31m" not in printed(example(), no_color=True)


def test_nesting_is_shown_when_asked_for() -> None:
    def printed(nesting: bool) -> str:
        console = Console(file=io.StringIO(), width=100)
        print_table(example(), console, nesting=nesting)
        return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]

    assert "Nesting" in printed(True)
    assert "Nesting" not in printed(False)


def test_the_smallest_gap_is_named() -> None:
    pairs = [pair("a", "b", "disjoint", 2.0), pair("c", "d", "b_inside_a", 0.25), pair("e", "f", "touching", 0.0)]
    report = build([tissue("a", "a.stl", "organ", 4, 0.5, 1.0)], pairs, [], {})
    assert "3 near pairs: 1 b inside a, 1 disjoint, 1 touching; smallest gap 0.250 mm, c - d" in render(report, "table")


def test_the_verdict_line() -> None:
    report = sound()
    assert closing_line(report) == "passed: 1 tissue, 3,312 triangles; 0 errors, 0 warnings, 0 notes; 1.25 s"
    report["run"] = {}
    assert closing_line(report).endswith("0 notes")
    report["run"] = {"seconds": {"read": 1.0, "total": 9.0}}
    assert seconds(report) == 9.0


def test_verdicts_of_a_tissue() -> None:
    assert judge([]).words == "pass"
    assert judge([finding("T007", ["a"])]).words == "pass"
    assert judge([finding("X005", ["a"]), finding("F010", ["a"])]).words == "pass, 2 warnings F010 X005"
    assert judge([finding("X001", ["a"]), finding("T001", ["a"]), finding("X005", ["a"])]).words == "2 errors T001 X001"
    assert judge([finding("X001", ["a"], known=True)]).words == "pass, 1 known X001"
    assert not judge([finding("X001", ["a"]), finding("T001", ["a"], known=True)]).passed


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, "-"),
        (0.0, "0"),
        (0.561483603, "0.561"),
        (7.14e-7, "7.14e-07"),
        (0.000393, "0.000393"),
        (1.0, "1.00"),
        (123.4, "123"),
        (999.4, "999"),
        (999.6, "1,000"),
        (-1634.2, "-1,634"),
        (1e9, "1.00e+09"),
        (float("nan"), "nan"),
    ],
)
def test_numbers(value: float | None, expected: str) -> None:
    assert number(value) == expected


def test_words() -> None:
    assert plural(1, "error") == "1 error"
    assert plural(1200, "error") == "1,200 errors"
    assert place({"xyz_mm": [-0.0001, 1e8, 2.0], "face": None}) == "(0.000, 1e+08, 2.000) mm"
