"""The command line of each bench, and the arithmetic of those that have some."""

from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from bench.__main__ import NAMES, parser
from bench.children.record_clips import clip_of
from bench.recovery.soak import growth
from bench.train import rate

PARSER = parser({name: import_module(f"bench.{name}") for name in NAMES})


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("physics --gpu --bodies ant rodent --num-envs 64", {"gpu": True, "bodies": ["ant", "rodent"]}),
        ("physics --engines native mjx", {"engines": ["native", "mjx"], "gpu": False, "num_envs": None}),
        (
            "physics --gpu --bodies robots rodent --at-once 8 --limit 60",
            {"bodies": ["robots", "rodent"], "limit": 60.0},
        ),
        ("train mark --seeds 2 --bodies ant --without-brax", {"parts": ["mark"], "seeds": 2}),
        ("train --gpu --quick", {"parts": [], "gpu": True, "quick": True}),
        (
            "train robots --bodies g1 --steps 500 --policies out",
            {"parts": ["robots"], "steps": 500, "policies": Path("out"), "settings": {}},
        ),
        ("service lists largest --only GET*", {"parts": ["lists", "largest"], "only": "GET*"}),
        ("service load --minutes 2", {"parts": ["load"], "minutes": 2.0}),
        ("recovery", {"parts": [], "kinds": None, "quick": False}),
        ("recovery outages soak --minutes 1", {"parts": ["outages", "soak"], "minutes": 1.0}),
        (
            "recovery --kinds faults outages damage --worlds 2 --first 40 --seeds 10",
            {"kinds": ["faults", "outages", "damage"], "worlds": 2, "first": 40, "seeds": 10},
        ),
        ("demo --fresh-clone", {"fresh_clone": True, "environment": "ant"}),
    ],
)
def test_a_bench_takes_its_arguments(line: str, told: dict[str, Any]) -> None:
    arguments = vars(PARSER.parse_args(line.split()))
    assert arguments["name"] == line.split()[0]
    assert told.items() <= arguments.items()


@pytest.mark.parametrize("line", ["", "gpu_ant", "physics --minutes 3", "recovery --kinds"])
def test_what_no_bench_takes_is_refused(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        PARSER.parse_args(line.split())
    assert "usage: ./run bench" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["train", "service", "recovery"])
def test_an_unknown_part_is_refused(name: str) -> None:
    with pytest.raises(SystemExit, match="no part 'gate'"):
        import_module(f"bench.{name}").measure(PARSER.parse_args([name, "gate"]))


def test_a_rate_is_that_of_the_second_half() -> None:
    assert rate([(100, 60.0), (200, 61.0), (300, 62.0), (400, 64.0)]) == pytest.approx(200 / 3)
    assert rate([(100, 60.0), (400, 63.0)]) == 100
    with pytest.raises(ValueError, match="only once"):
        rate([(100, 60.0)])


def test_growth_is_that_of_a_straight_line() -> None:
    assert growth([1.0, 3.0, 5.0]) == pytest.approx(4.0)
    assert growth([2.0, 0.0, 2.0]) == pytest.approx(0.0)
    assert growth([7.0]) == 0


def test_a_recorded_clip_has_the_joints_of_its_body_in_their_places() -> None:
    ball = '<geom size="0.1" mass="1"/>'
    end = f'<body><joint name="slider" type="slide"/>{ball}</body>'
    arm = f'<body><joint name="elbow" type="hinge"/>{ball}{end}</body>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body><freejoint/>{ball}{arm}</body></worldbody></mujoco>"
    )
    rows = np.array([[1.0, 2, 3, 2, 0, 0, 0, 5, 6], [1.0, 2, 3, 0, 2, 0, 0, 7, 8]])
    clip = clip_of("arm", rows, model, 20.0)
    assert clip.joints == ("elbow", "slider")
    np.testing.assert_array_equal(clip.joint_positions, [[5, 6], [7, 8]])
    np.testing.assert_array_equal(clip.root_position, [[1, 2, 3], [1, 2, 3]])
    np.testing.assert_array_equal(clip.root_orientation, [[1, 0, 0, 0], [0, 1, 0, 0]])
