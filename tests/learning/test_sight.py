"""The network that sees: what it learns from, that it learns, and that its file says what it says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from dream.evaluation.engines import Processes  # noqa: E402
from dream.geometry import SE3, Camera  # noqa: E402
from dream.learning.sight import making as whole  # noqa: E402
from dream.learning.sight.export import as_onnx  # noqa: E402
from dream.learning.sight.making import Making, make  # noqa: E402
from dream.learning.sight.network import CELLS, COARSE, FAINT, Shape, contrast  # noqa: E402
from dream.learning.sight.pictures import PICTURE, Album, draw, opened  # noqa: E402
from dream.learning.sight.training import SightTraining, fit, losses, marks, planes  # noqa: E402
from dream.learning.sight.waters import lesson  # noqa: E402
from dream.perception import Sight, View  # noqa: E402
from dream.perception.sight import DEPTH, GRID, HEIGHT, LABELS, WIDTH  # noqa: E402
from dream.perception.sight import planes as planes_of_one  # noqa: E402
from dream.types import Label  # noqa: E402

SMALL = Shape(encoder=(8, 8, 8, 8, 8), path=8, fine=4)


@pytest.fixture(scope="module")
def album(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return draw(Album(0, worlds=2, views=8, seed=5), tmp_path_factory.mktemp("pictures"))


@pytest.fixture(scope="module")
def pictures(album: Path) -> Any:
    return np.asarray(opened(album))


def plain(depth: float, count: int = 2) -> Any:
    """Views straight down on a grey floor, so many metres below."""
    made = np.zeros(count, PICTURE)
    made["rgb"], made["depth"], made["labels"] = 150, depth, Label.SEABED
    made["camera"] = 160.0, 160.0, 160.0, 120.0
    made["rotation"] = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    made["altitude"] = depth
    return made


def test_an_album_is_the_same_again_and_of_what_a_vehicle_sees(album: Path, tmp_path: Path) -> None:
    again = draw(Album(0, worlds=2, views=8, seed=5), tmp_path)
    assert again.read_bytes() == album.read_bytes()
    found = opened(album)
    assert len(found) == 16
    assert set(np.unique(found["labels"])) <= {int(label) for label in Label}
    known = np.isfinite(found["depth"])
    assert ((found["labels"] == Label.WATER) == ~known).all()
    assert float(np.nanmin(found["depth"])) >= 0.2
    assert (found["altitude"] > 0.0).all()


def test_a_damaged_album_is_named(album: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.pictures"
    path.write_bytes(album.read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"cut\.pictures: expected pictures"):
        opened(path)


def test_a_lesson_is_the_same_for_its_seed_and_other_water_for_another(pictures: Any) -> None:
    one, same, other = (lesson(pictures, seed) for seed in (1, 1, 2))
    assert torch.equal(one.rgb, same.rgb)
    assert not torch.equal(one.rgb, other.rgb)


def test_what_is_far_is_lost_in_the_water_and_what_is_near_is_not(pictures: Any) -> None:
    near = lesson(plain(0.8, 32), 3, plain=True)
    far = lesson(plain(300.0, 32), 3, plain=True)
    assert (near.labels == Label.SEABED).float().mean() > 0.9
    assert (far.labels == Label.WATER).float().mean() > 0.9
    assert torch.isnan(far.depth).float().mean() > 0.9


def test_a_mirrored_view_is_told_as_what_it_shows(pictures: Any) -> None:
    """In the mirror a label's column goes with the view's rays: depth along them stays that of the scene."""
    many = np.concatenate([pictures] * 3)
    given, straight = lesson(many, 7), lesson(many, 7, plain=True)
    turned = ~torch.isclose(given.camera[:, 2], straight.camera[:, 2])
    assert turned.any()
    assert not turned.all()
    torch.testing.assert_close(given.labels[turned], straight.labels[turned].flip(2))
    known = turned & torch.isfinite(given.altitude)
    view = planes(given)[known][:, 1]
    torch.testing.assert_close(view, planes(straight)[known][:, 1].flip(2), atol=1e-4, rtol=0.0)


def test_the_view_is_told_as_in_a_mission(pictures: Any) -> None:
    given = lesson(pictures, 4, plain=True)
    for k in range(4):
        camera = Camera(WIDTH, HEIGHT, *map(float, given.camera[k]))
        pose = SE3(pictures[k]["rotation"].astype(np.float64), np.zeros(3))
        view = View(camera, pose, SE3(np.eye(3), np.zeros(3)), float(given.altitude[k]))
        np.testing.assert_allclose(planes_of_one(view)[0], planes(given)[k].numpy(), atol=1e-4)


def test_where_neither_pose_nor_altitude_is_known_nothing_is_told(pictures: Any) -> None:
    given = lesson(np.concatenate([pictures] * 4), 5)
    unknown = torch.isnan(given.altitude)
    assert 0.0 < float(unknown.float().mean()) < 0.4
    assert (planes(given)[unknown] == 0.0).all()


def test_contrast_is_what_a_plain_loop_over_cells_gives() -> None:
    rng = np.random.default_rng(1)
    picture = rng.random((1, 3, HEIGHT, WIDTH)).astype(np.float32) * np.linspace(
        0.2, 1.0, WIDTH, dtype=np.float32
    )
    found = contrast(torch.from_numpy(picture), 3).numpy()
    # In the middle of a cell of 16 by 16 pixels nothing is interpolated but between two pixels about it.
    rows, cols = HEIGHT // CELLS[0], WIDTH // CELLS[1]
    for row, col in ((4, 7), (0, 0), (14, 19)):
        around = picture[
            0, :, rows * max(row - 1, 0) : rows * (row + 2), cols * max(col - 1, 0) : cols * (col + 2)
        ]
        at = (rows * row + rows // 2, cols * col + cols // 2)
        off = picture[0, :, at[0], at[1]] - around.mean((1, 2))
        np.testing.assert_allclose(found[0, :, at[0], at[1]], off / (around.std((1, 2)) + FAINT), atol=0.1)


def test_contrast_tells_the_same_in_a_veil(pictures: Any) -> None:
    """A veil halves all differences and adds light; where more than noise is left, contrast stays."""
    clear = torch.from_numpy(pictures["rgb"].transpose(0, 3, 1, 2).copy()).float() / 255.0
    veiled = 0.5 * clear + 0.4
    for cells in (3, 9):
        one, other = contrast(clear, cells), contrast(veiled, cells)
        seen = one.abs() > 1.0
        ratio = (other[seen] / one[seen]).numpy()
        assert np.quantile(ratio, 0.01) > 0.5
        assert 0.8 < np.median(ratio) <= np.quantile(ratio, 0.99) < 1.1


def test_a_training_begins_with_the_colours_of_the_world() -> None:
    """At first sand that is grey stays so, but for water; last it has stains and tints."""

    def spread(hard: float) -> float:
        given = lesson(plain(1.0, 48), 11, plain=True, hard=hard)
        return float(given.rgb.float().std((2, 3)).mean())

    assert spread(0.0) < spread(1.0)


def test_it_learns_what_is_plain_and_says_how_sure_it_is(tmp_path: Path) -> None:
    path = tmp_path / "floor.pictures"
    path.write_bytes(np.concatenate([plain(depth, 4) for depth in (0.7, 1.0, 1.4)]).tobytes())
    network, training = SMALL.build(0), SightTraining(batches=60, batch=4, warmup=5, rate=5e-3)
    told = list(fit(network, [path], training, kept=tmp_path / "state.pt"))
    assert told[-1].labels < 0.5 * told[0].labels
    assert told[-1].depth < 0.1
    found = marks(network, path, training)
    assert found["iou"]["seabed"] > 0.9
    assert found["depth_relative_error_within_8_m"] < 0.1


def test_it_goes_on_where_it_was_broken_off(album: Path, tmp_path: Path) -> None:
    training = SightTraining(batches=4, batch=2, warmup=2)
    once, twice = SMALL.build(0), SMALL.build(0)
    list(fit(once, [album], training, kept=tmp_path / "once.pt"))
    from dream.learning.sight import training as module

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "KEPT_EVERY", 2)
        patch.setattr(module, "TOLD_EVERY", 2)
        work = fit(twice, [album], training, kept=tmp_path / "twice.pt")
        assert next(work).number == 2
        work.close()
        again = SMALL.build(9)
        list(fit(again, [album], training, kept=tmp_path / "twice.pt"))
    for name, weights in once.state_dict().items():
        torch.testing.assert_close(weights, again.state_dict()[name], msg=name)


def test_a_foreign_state_is_named(album: Path, tmp_path: Path) -> None:
    (tmp_path / "state.pt").write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"state\.pt: expected the state"):
        list(fit(SMALL.build(0), [album], SightTraining(batches=2, batch=2), kept=tmp_path / "state.pt"))


def test_its_file_answers_as_it_does(pictures: Any, tmp_path: Path) -> None:
    network, given = Shape().build(3), lesson(pictures, 6, plain=True)
    path = tmp_path / "sight.onnx"
    path.write_bytes(as_onnx(Shape(), network))
    camera = Camera(WIDTH, HEIGHT, *map(float, given.camera[0]))
    pose = SE3(pictures[0]["rotation"].astype(np.float64), np.zeros(3))
    view = View(camera, pose, SE3(np.eye(3), np.zeros(3)), float(given.altitude[0]))
    answer = Sight(path).answer(given.rgb[0].permute(1, 2, 0).numpy().copy(), view)
    with torch.inference_mode():
        said = network.eval()(given.rgb[:1].float() / 255.0, planes(given)[:1])
    np.testing.assert_allclose(answer.shares, said[LABELS][0].softmax(0).numpy(), atol=1e-3)
    assert said[DEPTH].shape == (1, 2, *GRID)


def test_what_it_expects_to_be_off_by_is_learned(pictures: Any) -> None:
    """The depth's part of the loss is least where the width that is told is the mean error."""
    given = lesson(pictures, 8, plain=True)

    class Told(torch.nn.Module):  # type: ignore[misc, name-defined]
        def __init__(self, width: float) -> None:
            super().__init__()
            self.width = width

        def forward(self, picture: Any, view: Any) -> dict[str, Any]:
            depth = torch.zeros(len(picture), 2, *GRID)
            depth[:, 1] = self.width
            labels = {LABELS: torch.zeros(len(picture), 4, HEIGHT, WIDTH)}
            return {**labels, COARSE: torch.zeros(len(picture), 4, *GRID), DEPTH: depth}

    _, _, off = losses(Told(0.0), given, SightTraining())
    widths = np.log(off) + np.array([-0.5, 0.0, 0.5])
    narrow, right, wide = (float(losses(Told(float(width)), given, SightTraining())[0]) for width in widths)
    assert right < min(narrow, wide)


def test_all_of_it_leaves_a_network_and_its_card_and_goes_on(tmp_path: Path) -> None:
    small = Making(1, worlds=1, views=4, shape=SMALL, training=SightTraining(batches=2, batch=2))
    parts = {step.part for step in make(small, tmp_path, Processes(1), "cpu")}
    assert parts == {"albums of pictures", "batches", "network and card"}
    before = (tmp_path / whole.MODEL).read_bytes()
    (tmp_path / whole.MODEL).unlink()
    list(make(small, tmp_path, Processes(1), "cpu"))
    assert (tmp_path / whole.MODEL).read_bytes() == before
    Sight(tmp_path / whole.MODEL)
    with pytest.raises(ValueError, match="Choose another --out"):
        list(make(Making(1, seed=3, worlds=1, views=4), tmp_path, Processes(1), "cpu"))
