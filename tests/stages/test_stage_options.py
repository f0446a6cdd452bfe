"""Options by key: types, ranges, and where a mistake is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import pytest

from vhp_cli.errors import UsageError
from vhp_cli.stages.decimate.options import DecimateOptions
from vhp_cli.stages.heal.options import HealOptions
from vhp_cli.stages.options import Flag, Keys, Name, Number, StageOptions, Text
from vhp_cli.stages.refine.options import RefineOptions
from vhp_cli.stages.smooth.options import SmoothOptions


@dataclass(frozen=True, slots=True)
class Options(StageOptions):
    known: ClassVar[Keys] = {
        "share": ("share", Number(0, 1)),
        "edge-length": ("edge_mm", Number(may_be_least=True)),
        "count": ("count", Number(4, 100, may_be_least=True, whole=True)),
        "fast": ("fast", Flag()),
        "method": ("method", Name(("one", "three"))),
        "file": ("file", Text()),
    }
    share: float | None = None
    edge_mm: float = 2.0
    count: int | None = None
    fast: bool = False
    method: str = "one"
    file: str | None = None
    hidden: float = -1.0


def test_values_are_put_in_place():
    values = {"share": 1, "edge-length": 0, "count": 4.0, "fast": True, "method": "three", "file": "a.npy"}
    options = Options().changed(values, "here")
    assert options == Options(1.0, 0.0, 4, True, "three", "a.npy")
    assert type(options.share) is float and type(options.count) is int
    assert options.as_dict() == values
    assert Options().changed({}, "here") == Options()
    assert Options().as_dict()["share"] is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"shares": 1}, "here: 'shares' is not known; did you mean 'share'?"),
        ({"xyz": 1}, "here: 'xyz' is not known"),
        ({"hidden": 1}, "here: 'hidden' is not known"),
        ({"share": True}, "here.share: expected a number, not True"),
        ({"share": "1"}, "here.share: expected a number, not '1'"),
        ({"share": 0}, "here: share: expected a finite number above 0 and at most 1, not 0"),
        ({"share": 1.5}, "here: share: expected a finite number above 0 and at most 1, not 1.5"),
        ({"share": math.nan}, "here: share: expected a finite number above 0 and at most 1, not nan"),
        ({"edge-length": -0.5}, "here: edge-length: expected a finite number at least 0, not -0.5"),
        ({"edge-length": math.inf}, "here: edge-length: expected a finite number at least 0, not inf"),
        ({"count": 4.5}, "here.count: expected a whole number, not 4.5"),
        ({"count": math.inf}, "here.count: expected a whole number, not inf"),
        ({"count": math.nan}, "here.count: expected a whole number, not nan"),
        ({"count": 3}, "here: count: expected a finite number at least 4 and at most 100, not 3"),
        ({"fast": 1}, "here.fast: expected true or false, not 1"),
        ({"method": 2}, "here.method: expected one of one, three, not 2"),
        ({"method": "tree"}, "here: method: 'tree' is not known; did you mean 'three'?"),
        ({"method": "zzz"}, "here: method: 'zzz' is not known; one of one, three"),
        ({"file": 3}, "here.file: expected a text, not 3"),
        ({"file": ""}, "here: file: expected a text that is not empty"),
    ],
)
def test_mistakes_are_named(values, message):
    with pytest.raises(UsageError) as caught:
        Options().changed(values, "here")
    assert caught.value.message == message


def test_values_are_checked_without_a_file_too():
    with pytest.raises(UsageError, match="share"):
        Options(share=2.0)


@pytest.mark.parametrize("options", [HealOptions(), SmoothOptions(), DecimateOptions(), RefineOptions()])
def test_every_stage_takes_back_what_it_tells(options):
    told = {key: value for key, value in options.as_dict().items() if value is not None}
    assert options.changed(told, "report") == options
    for field, _ in options.known.values():
        assert hasattr(options, field)
