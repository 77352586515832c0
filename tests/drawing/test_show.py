import json
import re

import click
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from hhtbench.cli import main as cli
from hhtbench.drawing import draw, files
from hhtbench.drawing.motion import Course, find_course
from hhtbench.drawing.scene import make_scene
from hhtbench.protocol.errors import ProblemError


@pytest.fixture
def show(monkeypatch, rotor):
    """show(*words, **fields): the command on rotors with these fields."""

    def run(*words, **fields):
        monkeypatch.setattr(files, "load_problem", lambda spec: rotor(**{"name": spec, **fields}))
        return CliRunner().invoke(cli.main, ["show", *words])

    return run


def _phases(figure):
    return [c for c in figure.axes[0].collections if str(c.get_gid()).startswith("phase-")]


@pytest.mark.parametrize("count", [2, 5, 12])
def test_still_holds_so_many_phases_the_last_one_strongest(rotor, count):
    problem = rotor()
    figure = draw.stroboscope(make_scene(problem, find_course(problem)), count)
    strengths = [phase.get_alpha() for phase in _phases(figure)]
    assert len(strengths) == count
    assert strengths[-1] == 1.0
    assert strengths[1:] == sorted(strengths[1:])
    assert max(strengths[:-1]) < 0.9


def test_phases_stand_where_the_motion_has_them_and_the_ground_is_drawn_once(rotor):
    problem = rotor()
    scene = make_scene(problem, find_course(problem, seconds=3.0))
    figure = draw.stroboscope(scene, 4)
    ends = [phase.get_segments()[0][1] for phase in _phases(figure)]
    t = scene.t[scene.pick(4)]
    np.testing.assert_allclose(ends, np.stack([np.cos(t), np.sin(t)], axis=1), atol=1e-12)
    grounds = [c for c in figure.axes[0].collections if c.get_gid() == "ground"]
    assert [len(c.get_segments()) for c in grounds] == [1]


def test_both_axes_have_the_same_scale(rotor):
    problem = rotor()
    axes = draw.stroboscope(make_scene(problem, find_course(problem))).axes[0]
    across, up = axes.transData.transform([(1.0, 0.0), (0.0, 1.0)]) - axes.transData.transform((0.0, 0.0))
    assert across[0] == pytest.approx(up[1])


def test_phases_of_a_motion_along_a_line_stand_below_one_another(rotor):
    problem = rotor(sketch=lambda q: {"points": np.array([[q[0], 0.0]]), "lines": np.array([[[0.0, 0.0], [q[0], 0.0]]])})
    figure = draw.stroboscope(make_scene(problem, find_course(problem)), 5)
    heights = [phase.get_segments()[0][0][1] for phase in _phases(figure)]
    assert np.all(np.diff(heights) < 0)


def test_motion_in_space_stands_on_a_floor_and_up_is_up(rotor, in_space):
    problem = rotor(sketch=in_space)
    scene = make_scene(problem, find_course(problem))
    assert scene.points.shape[1:] == (2, 2)
    assert len(scene.floor) == 4
    assert np.ptp(scene.points[:, 1], axis=0) == pytest.approx([2.0, 2.0 * np.sin(np.radians(22))], rel=1e-3)

    def mast(up):
        return lambda q: {"points": np.zeros((1, 3)), "lines": np.array([[np.zeros(3), np.eye(3)[up]]]), "up": up}

    for up in (0, 1, 2):
        problem = rotor(sketch=mast(up))
        top = make_scene(problem, find_course(problem)).lines[0, 0, 1]
        np.testing.assert_allclose(top, [0.0, np.cos(np.radians(22))], atol=1e-12)


def test_file_with_vectors_names_every_phase(show, tmp_path):
    result = show("rotor", "--out", str(tmp_path / "r.svg"), "--frames", "7")
    assert result.exit_code == 0, result.output
    text = (tmp_path / "r.svg").read_text()
    assert len(re.findall(r'<g id="phase-\d+"', text)) == 7
    assert "closed solution" in result.output


def test_film_has_so_many_pictures(show, tmp_path):
    assert show("rotor", "--out", str(tmp_path / "r.gif"), "--frames", "6").exit_code == 0
    with Image.open(tmp_path / "r.gif") as film:
        assert film.n_frames == 6
        assert film.info["loop"] == 0
    assert show("rotor", "--out", str(tmp_path / "r.html"), "--frames", "5").exit_code == 0
    page = (tmp_path / "r.html").read_text()
    assert page.count("iVBOR") == 5  # every PNG begins so
    assert "http" not in page


def test_picture_is_written_beside_where_no_file_is_named(show, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert show("rotor").exit_code == 0
    with Image.open(tmp_path / "rotor.png") as picture:
        assert picture.width == 800


def test_problem_without_sketch_is_told_what_to_declare(show, tmp_path):
    result = show("bare", "--out", str(tmp_path / "b.png"), sketch=None)
    assert result.exit_code == 2
    assert "bare declares no sketch" in result.output
    assert '"points": (k, d), "lines": (l, 2, d)' in result.output
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("out", "text"), [("r.bmp", ".png, .svg, .gif, .html; got r.bmp"), ("not/there/r.png", "there is no folder")]
)
def test_wrong_file_is_refused_before_any_work(show, tmp_path, monkeypatch, out, text):
    monkeypatch.setattr(files, "find_course", lambda *a: pytest.fail("a solver was started"))
    result = show("rotor", "--out", str(tmp_path / out))
    assert result.exit_code == 2
    assert text in result.output


def test_sketch_of_the_wrong_shape_is_refused(rotor):
    problem = rotor(sketch=lambda q: {"points": np.zeros((2, 2)), "lines": np.zeros((3, 2))})
    with pytest.raises(ProblemError, match=r"lines \(l, 2, d\).*got \(2, 2\) and \(3, 2\)"):
        find_course(problem)


def test_motion_that_was_not_finished_is_labelled_in_the_terminal_and_under_the_picture(show, tmp_path, monkeypatch):
    def partly(problem, *_):
        t = np.linspace(0.0, 2.0, 50)
        q = np.stack([np.cos(t), np.sin(t)], axis=1)
        return Course(t=t, q=q, source="ida", stopped="ida stopped at t = 2 s: step_too_small")

    monkeypatch.setattr(files, "find_course", partly)
    result = show("rotor", "--out", str(tmp_path / "r.svg"), "--json", str(tmp_path / "r.json"))
    assert result.exit_code == 1
    (told,) = json.loads((tmp_path / "r.json").read_text())["drawings"]
    assert (told["t"], told["states"], told["failed"]) == ([0.0, 2.0], "ida", "ida stopped at t = 2 s: step_too_small")
    assert "ida stopped at t = 2 s: step_too_small" in result.output
    assert "t = 2 s: step_too_small" in (tmp_path / "r.svg").read_text()


def test_note_of_a_sketch_stands_under_the_picture(rotor):
    bent = rotor().sketch
    problem = rotor(sketch=lambda q: {**bent(q), "note": "drawn 20 times"})
    figure = draw.stroboscope(make_scene(problem, find_course(problem)))
    assert "drawn 20 times" in figure.texts[0].get_text()


def test_all_draws_every_registered_problem_and_names_those_it_cannot(rotor, tmp_path, monkeypatch):
    made = {"one": rotor(name="one"), "bare": rotor(name="bare", sketch=None), "two": rotor(name="two")}
    monkeypatch.setattr(files, "list_problems", lambda: list(made))
    monkeypatch.setattr(files, "load_problem", made.__getitem__)
    result = CliRunner().invoke(
        cli.main, ["show", "--all", "--out", str(tmp_path / "t"), "--json", str(tmp_path / "all.json")]
    )
    assert result.exit_code == 1
    told = {one["problem"]: one["failed"] for one in json.loads((tmp_path / "all.json").read_text())["drawings"]}
    assert told == {"one": "", "bare": told["bare"], "two": ""}
    assert "declares no sketch" in told["bare"]
    assert "bare: NOT DRAWN: ProblemError: bare declares no sketch" in result.output
    assert sorted(file.name for file in (tmp_path / "t").iterdir()) == ["one.png", "two.png"]
    with Image.open(tmp_path / "t" / "one.png") as picture:
        assert picture.size == (320, 240)


@pytest.mark.parametrize("words", [[], ["rotor", "--all"], ["--all"], ["--all", "--out", "t", "--seconds", "1"]])
def test_contradicting_words_are_refused(show, words):
    assert show(*words).exit_code == click.UsageError.exit_code
