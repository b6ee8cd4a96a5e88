"""The walker's own camera as an observation: what small images cost beside a control step."""

from bench.measure.child import run_child
from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result
from bench.measure.statistics import ratios, spread

_NUM_ENVS, _SIDE, _DEPTH_SIDE = 64, 64, 16


def measure(options: Options) -> Result:
    """Steps without and with a depth image, OpenGL and MuJoCo Warp's rays, in turns."""
    machine = this_machine()
    request = {
        "walker": "ant",
        "num_envs": 4 if options.quick else _NUM_ENVS,
        "side": _SIDE,
        "depth_side": _DEPTH_SIDE,
        "rounds": 1 if options.quick else 5,
        "seconds": 0.1 if options.quick else 2.0,
    }
    run = run_child("bench.ours.draw_egocentric", request, timeout_s=900)
    measured = ("step", "step_with_depth", "drawn", "cast")
    milliseconds = {name: [1000 * value for value in run[name]] for name in measured}
    return Result(
        name="egocentric",
        title="Pictures by the ant's own camera",
        command="./run bench egocentric",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure.of("a control step", spread(milliseconds["step"]), "ms"),
            Figure.of("a control step with a depth image", spread(milliseconds["step_with_depth"]), "ms"),
            Figure.of("drawn by OpenGL", spread(milliseconds["drawn"]), "ms"),
            Figure.of("cast by MuJoCo Warp's rays", spread(milliseconds["cast"]), "ms"),
            Figure.of(
                "step with a depth image ÷ step",
                ratios(milliseconds["step_with_depth"], milliseconds["step"]),
                "×",
            ),
            Figure.of("drawn ÷ step", ratios(milliseconds["drawn"], milliseconds["step"]), "×"),
            Figure.of("cast ÷ step", ratios(milliseconds["cast"], milliseconds["step"]), "×"),
        ],
        rows=[
            {"round": turn, "what": name, "ms": value}
            for name, values in milliseconds.items()
            for turn, value in enumerate(values)
        ],
        notes=[
            f"{request['num_envs']} environments over gaps, each with one picture of {_SIDE}×{_SIDE} pixels "
            "by `walker/egocentric`, without shadows, reflections and smooth edges, or with a depth image of "
            f"{_DEPTH_SIDE}×{_DEPTH_SIDE} pixels by `egocentric_depth`; physics by `compiled`, as `auto` "
            "takes it.",
            f"OpenGL: {run['gl_renderer']}. Rays: Warp on {run['warp_device']}.",
        ],
    )
