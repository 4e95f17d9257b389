"""Films, figures and the page: what is written can be read back and shows what it should."""

import dataclasses
import doctest
import json
from fractions import Fraction
from html.parser import HTMLParser
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

import preimage.report
from preimage.records import Percept, Plan, Scene, Stopped, Trial
from preimage.report.charts import GROWTH, growth_chart, intention_map
from preimage.report.figures import DOTS_PER_INCH, WIDTH_INCHES, figure, learning_curve
from preimage.report.films import film
from preimage.report.pages import Case, page

WHITE_AFTER = 255


def make_plan(*, shape=(64, 64, 1), num_steps=12, arrival_step=8, joint_names=("yaw", "shoulder"), rate_hz=10.0) -> Plan:
    """Frames are a grey that rises to arrival and are white beyond it: a white picture gives away a film that runs too far."""
    frames = np.full((num_steps, *shape), WHITE_AFTER, np.uint8)
    for step in range(arrival_step + 1):
        frames[step] = 10 * step
    joints = np.linspace(0, 1, num_steps)[:, None] * np.arange(1, len(joint_names) + 1)
    return Plan(
        frames=frames,
        joints=joints,
        arrival_step=arrival_step,
        rate_hz=rate_hz,
        joint_names=joint_names,
        start=Percept(frames[0], joints[0]),
        goal=Percept(np.full(shape, 200, np.uint8)),
        error=12.5,
        errors=np.array([50.0, 20.0, 12.5]),
        intention=np.zeros(1),
        stopped=Stopped.ITERATIONS,
        seconds=3.2,
    )


def make_trial(plan: Plan, *, num_steps=10, success=True) -> Trial:
    frames = np.full((num_steps, *plan.frames.shape[1:]), 120, np.uint8)
    joints = np.zeros((num_steps, len(plan.joint_names)))
    scene = Scene("reach", (0.0,) * len(plan.joint_names), {"goal": (0.3, 0.0, 0.03)})
    return Trial(frames, joints, np.zeros((num_steps, 3)), 0.021 if success else 0.063, success, scene)


def decode(path: Path) -> np.ndarray:
    with av.open(str(path)) as container:
        return np.stack([picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)])


def panel_pixel(picture: np.ndarray, panel: int, num_panels: int) -> int:
    """The grey in the middle of a panel."""
    return int(picture[160, picture.shape[1] * (2 * panel + 1) // (2 * num_panels)].mean())


def test_mp4_decodes_to_every_step_of_the_longer_film_and_one_second_more(tmp_path):
    plan = make_plan()
    pictures = decode(film(plan, make_trial(plan), tmp_path / "a.mp4"))
    assert len(pictures) == 10 + 10
    assert pictures.shape[1:3] == (256 + 32 + 36, 3 * 256 + 4 * 16)


@pytest.mark.parametrize(("show", "name"), [(film, "a.mp4"), (figure, "a.png")])
def test_a_trial_that_was_not_filmed_is_refused(tmp_path, show, name):
    plan = make_plan()
    trial = dataclasses.replace(make_trial(plan), frames=np.zeros((0, 64, 64, 1), np.uint8))
    with pytest.raises(ValueError, match="the trial was not filmed: execute the plan anew, with filmed=True"):
        show(plan, trial, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_mp4_is_h264_in_yuv420p_at_the_plans_rate(tmp_path):
    path = film(make_plan(rate_hz=2.5), None, tmp_path / "a.mp4")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert stream.average_rate == Fraction(5, 2)


def test_imagined_panel_ends_at_arrival_and_holds(tmp_path):
    plan = make_plan()
    pictures = decode(film(plan, make_trial(plan, num_steps=12), tmp_path / "a.mp4"))
    greys = [panel_pixel(picture, 1, 3) for picture in pictures]
    np.testing.assert_allclose(greys[:9], plan.frames[:9, 0, 0, 0], atol=4)
    np.testing.assert_allclose(greys[9:], 80, atol=4)


def test_panels_show_goal_imagined_executed_in_this_order(tmp_path):
    plan = make_plan()
    first = decode(film(plan, make_trial(plan), tmp_path / "a.mp4"))[0]
    np.testing.assert_allclose([panel_pixel(first, i, 3) for i in range(3)], [200, 0, 120], atol=4)


def test_gif_has_one_picture_a_step_and_holds_the_last(tmp_path):
    with Image.open(film(make_plan(), None, tmp_path / "a.gif")) as gif:
        assert gif.n_frames == 9
        durations = []
        for step in range(gif.n_frames):
            gif.seek(step)
            durations.append(gif.info["duration"])
    assert durations == [100] * 8 + [1100]


def test_gif_keeps_the_grey_levels_of_the_frames(tmp_path):
    with Image.open(film(make_plan(), None, tmp_path / "a.gif")) as gif:
        gif.seek(4)
        shown = np.asarray(gif.convert("RGB"))
    np.testing.assert_allclose([panel_pixel(shown, 0, 2), panel_pixel(shown, 1, 2)], [200, 40], atol=2)
    panels = shown[32:-36].astype(int)
    assert np.abs(panels[:, 16:272] - panels[:, 16:272, :1]).max() <= 2, "grey frames took on a tint"


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
@pytest.mark.parametrize(
    ("shape", "panel"),
    [((64, 64, 3), (256, 256)), ((30, 53, 3), (120, 212)), ((17, 9, 1), (255, 200)), ((300, 401, 1), (300, 401))],
)
def test_films_take_colour_and_any_size(tmp_path, suffix, shape, panel):
    plan = make_plan(shape=shape, num_steps=4, arrival_step=2)
    pictures = decode(film(plan, None, tmp_path / f"a{suffix}"))
    height, width = panel[0] + 68, 2 * panel[1] + 48
    assert pictures.shape[1:3] == (height + height % 2, width + width % 2)


def test_colour_frames_stay_in_colour(tmp_path):
    plan = make_plan(shape=(64, 64, 3))
    plan.goal.frame[...] = (200, 40, 40)
    red, green, _ = decode(film(plan, None, tmp_path / "a.mp4"))[0][160, 144]
    assert red > 170
    assert green < 80


def test_a_goal_without_an_image_leaves_its_panel_empty(tmp_path):
    plan = make_plan()
    plan = Plan(**{**vars(plan), "goal": Percept(joints=plan.joints[-1])})
    assert film(plan, None, tmp_path / "a.gif").exists()
    assert figure(plan, None, tmp_path / "a.png").exists()


@pytest.mark.parametrize(("name", "named"), [("a.avi", "'.avi'"), ("a", "'no suffix'")])
def test_another_suffix_is_refused_in_one_sentence(tmp_path, name, named):
    with pytest.raises(ValueError, match=r"a film can be written as \.mp4 or \.gif") as refusal:
        film(make_plan(), None, tmp_path / name)
    assert named in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert not list(tmp_path.iterdir())


def test_a_film_that_breaks_off_leaves_the_old_one_in_place(tmp_path, monkeypatch):
    path = film(make_plan(), None, tmp_path / "a.gif")
    before = path.read_bytes()

    def break_off(unfinished, pictures, rate_hz):
        unfinished.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setitem(preimage.report.films._WRITERS, ".gif", break_off)
    with pytest.raises(KeyboardInterrupt):
        film(make_plan(), None, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.gif"]


@pytest.mark.parametrize(
    ("shape", "joint_names"),
    [((64, 64, 1), ("yaw", "shoulder", "elbow", "wrist", "gripper")), ((30, 53, 3), tuple(f"j{i}" for i in range(26)))],
)
@pytest.mark.parametrize("executed", [True, False])
def test_figure_is_a_png_of_plausible_size_with_something_on_it(tmp_path, shape, joint_names, executed):
    plan = make_plan(shape=shape, joint_names=joint_names)
    trial = make_trial(plan) if executed else None
    with Image.open(figure(plan, trial, tmp_path / "a.png")) as png:
        assert png.format == "PNG"
        assert 1000 < png.width < 2000
        assert 500 < png.height < 2000
        assert np.asarray(png.convert("L")).std() > 20


@pytest.fixture
def curves(monkeypatch, tmp_path):
    """The numbers that a figure draws of the joints and the labels of their axes, from top to bottom."""

    def draw(plan: Plan, trial: Trial | None, joint_unit: str | None) -> dict[str, np.ndarray]:
        drawn = []
        monkeypatch.setattr(preimage.report.figures, "save", lambda drawing, path: drawn.append(drawing) or Path(path))
        figure(plan, trial, tmp_path / "a.png", joint_unit=joint_unit)
        strips = [axes for axes in drawn[0].axes if axes.lines]
        lines = {axes.get_ylabel(): [line for line in axes.lines if line.get_linewidth() == 2.6] for axes in strips}
        return {label: np.array([line.get_ydata() for line in several]) for label, several in lines.items()}

    return draw


NAMES = "yaw", "finger_1", "left_gripper"


@pytest.mark.parametrize(
    ("executed", "unit", "wanted"),
    [
        (False, "rad", {"joint angle (°)": ((0, 1, 2), 180 / np.pi)}),
        (False, "deg", {"joints (deg)": ((0, 1, 2), 1)}),
        (False, None, {"joints": ((0, 1, 2), 1)}),
        (True, None, {"joint angle (°)": ((0, 1), 180 / np.pi), "gripper (m)": ((2,), 1)}),
    ],
)
def test_joints_are_drawn_in_the_unit_that_the_label_tells(curves, executed, unit, wanted):
    plan = make_plan(joint_names=NAMES)
    drawn = curves(plan, make_trial(plan) if executed else None, unit)
    assert list(drawn) == list(wanted)
    for label, (joints, factor) in wanted.items():
        np.testing.assert_allclose(drawn[label], factor * plan.joints[: plan.arrival_step + 1, list(joints)].T)


def test_figure_of_a_plan_that_is_there_at_once(tmp_path):
    plan = make_plan(num_steps=3, arrival_step=0)
    assert figure(plan, make_trial(plan, num_steps=1), tmp_path / "a.png").exists()
    assert len(decode(film(plan, make_trial(plan, num_steps=1), tmp_path / "a.mp4"))) == 1 + 10


def make_results(**changes) -> dict:
    rows = [{"goal": g, "deviation_cm": 1.1 + g, "success": g < 3, "arrival_step": 20 + g, "error": 7.25, "seconds": 3.5} for g in range(5)]
    luck = {"success": 2, "success_rate": 0.4, "interval": [0.118, 0.769]}
    results = {
        "task": "reach", "model": "runs/reach", "size": "small", "num_demonstrations": 100, "goals": 5, "seed": 1,
        "loop": "closed", "success": 3, "success_rate": 0.6, "interval": [0.231, 0.882], "seconds_per_plan": 3.5,
        "deviation_cm": {"mean": 3.1, "median": 3.1, "max": 5.1}, "rows": rows,
        "baselines": {
            "do_nothing": {**luck, "success": 0, "deviation_cm": {"mean": 31.0, "median": 30.0, "max": 55.0}},
            "nearest_demonstration": {**luck, "deviation_cm": {"mean": 4.4, "median": 4.0, "max": 9.9}},
        },
    }  # fmt: skip
    return json.loads(json.dumps(results | changes))


def make_cases(folder: Path) -> list[Case]:
    return [
        Case("goal 0", folder / "goal 0.mp4", folder / "goal 0.png", 0.011, True),
        Case("goal <4>", folder / "media" / "4.gif", folder / "media" / "4.png", 0.051, False),
    ]


def test_page_says_the_count_the_interval_and_every_goal(tmp_path):
    text = page(make_results(), make_cases(tmp_path), tmp_path / "index.html", title="Reach").read_text()
    assert "<strong>3/5</strong>" in text
    assert "Wilson 95 % interval 23–88 %" in text
    for goal in range(5):
        assert f'<th scope="row" data-head="goal">{goal}</th><td data-head="deviation (cm)">{1.1 + goal:.1f}</td>' in text


def test_page_puts_both_baselines_beside(tmp_path):
    text = page(make_results(), [], tmp_path / "index.html", title="Reach").read_text()
    assert "do nothing" in text
    assert "<b>0/5</b>" in text
    assert "nearest demonstration" in text
    assert "<b>2/5</b>" in text


def test_page_marks_failures(tmp_path):
    text = page(make_results(), make_cases(tmp_path), tmp_path / "index.html", title="Reach").read_text()
    assert text.count('<tr class="failure">') == 2
    assert text.count('class="case failure"') == 1
    assert text.count("✗ failure") == 3


def test_page_escapes_what_it_is_given(tmp_path):
    results = make_results(task="<script>alert(1)</script>", model="a&b")
    text = page(results, make_cases(tmp_path), tmp_path / "index.html", title="R & D <b>", success_means="x < 4").read_text()
    assert "<script>" not in text
    assert "<title>R &amp; D &lt;b&gt;</title>" in text
    assert "a&amp;b" in text
    assert "goal &lt;4&gt;" in text
    assert "x &lt; 4" in text


def test_page_names_films_relative_to_itself_and_nothing_on_a_network(tmp_path):
    text = page(make_results(), make_cases(tmp_path), tmp_path / "index.html", title="Reach").read_text()
    assert '<video src="goal%200.mp4"' in text
    assert '<img src="media/4.gif"' in text
    assert "http" not in text
    assert str(tmp_path) not in text


def test_page_closes_every_element_it_opens(tmp_path):
    class Balance(HTMLParser):
        open_elements: tuple[str, ...] = ()

        def handle_starttag(self, tag, attrs):
            if tag not in ("meta", "img", "br"):
                self.open_elements += (tag,)

        def handle_endtag(self, tag):
            assert self.open_elements[-1] == tag
            self.open_elements = self.open_elements[:-1]

    balance = Balance()
    balance.feed(page(make_results(), make_cases(tmp_path), tmp_path / "index.html", title="Reach").read_text())
    assert balance.open_elements == ()


def test_page_shows_a_dash_for_what_is_not_known(tmp_path):
    results = make_results()
    results["rows"][0]["error"] = None
    assert '<td data-head="prediction error">–</td>' in page(results, [], tmp_path / "index.html", title="Reach").read_text()


def test_page_refuses_results_that_are_none(tmp_path):
    with pytest.raises(ValueError, match="results has no rows, baselines; give the JSON that `preimage evaluate` writes"):
        page({k: v for k, v in make_results().items() if k not in ("rows", "baselines")}, [], tmp_path / "a.html", title="")


def test_learning_curve_leaves_out_a_line_cut_short(tmp_path):
    log = tmp_path / "log.jsonl"
    lines = [json.dumps({"update": u, "visual": 500 / u, "proprioceptive": 4 / u}) for u in range(1, 200)]
    log.write_text("\n".join(lines) + '\n{"update": 200, "vis')
    with Image.open(learning_curve(log, tmp_path / "curve.png")) as png:
        assert png.format == "PNG"
        assert png.width > 1000
        assert np.asarray(png.convert("L")).std() > 10


def test_learning_curve_says_what_is_wrong_with_a_log(tmp_path):
    log = tmp_path / "log.jsonl"
    log.write_text("")
    with pytest.raises(ValueError, match="holds no update yet"):
        learning_curve(log, tmp_path / "curve.png")
    log.write_text('oops\n{"update": 1, "visual": 2.0, "proprioceptive": 1.0}\n')
    with pytest.raises(ValueError, match="line 1 that is no JSON"):
        learning_curve(log, tmp_path / "curve.png")


def test_the_example_of_the_room_runs():
    assert doctest.testmod(preimage.report).failed == 0


def test_charts_are_pictures(tmp_path):
    growth = {name: {"1": 0.5, "2": 1.0} for name in GROWTH}
    places = {"training": [[0.0, 1.0], [1.0, 2.0], [2.0, 0.5]], "novel": [[0.5, 1.0]]}
    recognition = {"map": places, "goals_m": {name: [[0.3, 0.1]] * len(several) for name, several in places.items()}}
    for path in (growth_chart(growth, tmp_path / "growth.png"), intention_map(recognition, tmp_path / "map.png")):
        with Image.open(path) as png:
            assert png.width == WIDTH_INCHES * DOTS_PER_INCH
