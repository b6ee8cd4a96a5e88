"""The walker's own camera as an observation: what small pictures cost beside the physics of a step."""

from bench.measure.child import run_child
from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result
from bench.measure.statistics import ratios, spread

_NUM_ENVS, _SIDE = 64, 64


def measure(options: Options) -> Result:
    """Physics, OpenGL and MuJoCo Warp's rays in turns, over the same environments."""
    machine = this_machine()
    request = {
        "walker": "ant",
        "num_envs": 4 if options.quick else _NUM_ENVS,
        "side": _SIDE,
        "rounds": 1 if options.quick else 5,
        "seconds": 0.1 if options.quick else 2.0,
    }
    run = run_child("bench.ours.draw_egocentric", request, timeout_s=900)
    milliseconds = {name: [1000 * value for value in run[name]] for name in ("physics", "drawn", "cast")}
    return Result(
        name="egocentric",
        title="Pictures by the ant's own camera",
        command="./run bench egocentric",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure.of("a control step's physics", spread(milliseconds["physics"]), "ms"),
            Figure.of("drawn by OpenGL", spread(milliseconds["drawn"]), "ms"),
            Figure.of("cast by MuJoCo Warp's rays", spread(milliseconds["cast"]), "ms"),
            Figure.of("drawn ÷ physics", ratios(milliseconds["drawn"], milliseconds["physics"]), "×"),
            Figure.of("cast ÷ physics", ratios(milliseconds["cast"], milliseconds["physics"]), "×"),
        ],
        rows=[
            {"round": turn, "what": name, "ms": value}
            for name, values in milliseconds.items()
            for turn, value in enumerate(values)
        ],
        notes=[
            f"{request['num_envs']} environments over gaps, each with one picture of {_SIDE}×{_SIDE} pixels "
            "by `walker/egocentric`, without shadows, reflections and smooth edges; physics by `compiled`, "
            "as `auto` takes it.",
            f"OpenGL: {run['gl_renderer']}. Rays: Warp on {run['warp_device']}.",
        ],
    )
