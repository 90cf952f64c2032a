"""Which pictures a folder holds, and how they are opened."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dream.teaching.pictures import Picture, chosen, pictures_in, shown, shown_size
from tests.teaching.lessons import save_picture, scene


def test_a_run_shows_what_its_camera_took(tmp_path: Path) -> None:
    for what in ("rgb", "depth", "labels"):
        save_picture(tmp_path / f"frames/0004_{what}.png", scene(1)[0])
    assert [picture.name for picture in pictures_in(tmp_path)] == ["0004_rgb"]


def test_of_many_pictures_some_are_spaced_evenly_and_the_marked_ones_stay(tmp_path: Path) -> None:
    found = [Picture(tmp_path / f"{n:03d}.jpg") for n in range(101)]
    kept = [picture.name for picture in chosen(found, 3, ["007"])]
    assert kept == ["000", "007", "050", "100"]
    assert len(chosen(found, 500, [])) == 101
    assert [picture.name for picture in chosen(found, 0, ["009"])] == ["009"]


def test_marks_of_no_picture_are_told(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r'no picture for the marks "reeff".* Did you mean "reef"'):
        chosen([Picture(tmp_path / "reef.jpg")], 5, ["reeff"])


def test_folders_without_pictures_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"expected a folder of pictures"):
        pictures_in(tmp_path / "nowhere")
    with pytest.raises(ValueError, match=r"got none"):
        pictures_in(tmp_path)
    save_picture(tmp_path / "a.png", scene(1)[0])
    save_picture(tmp_path / "a.jpg", scene(1)[0])
    with pytest.raises(ValueError, match=r"got a\.jpg and a\.png"):
        pictures_in(tmp_path)


def test_a_picture_is_turned_as_its_camera_was_held(tmp_path: Path) -> None:
    image = Image.fromarray(scene(1, (48, 64))[0])
    exif = Image.Exif()
    exif[0x0112] = 6
    image.save(tmp_path / "a.jpg", exif=exif)
    assert Picture(tmp_path / "a.jpg").open().shape == (64, 48, 3)


@pytest.mark.parametrize("what", ["text", "deep", "small", "cut", "bomb"])
def test_what_is_no_picture_is_refused(tmp_path: Path, what: str) -> None:
    path = tmp_path / "a.png"
    if what == "text":
        path.write_text("no picture")
    elif what == "deep":
        Image.fromarray(np.zeros((32, 32), np.uint16)).save(path)
    elif what == "small":
        Image.new("RGB", (8, 200)).save(path)
    elif what == "cut":
        save_picture(path, scene(1)[0])
        path.write_bytes(path.read_bytes()[:3000])
    else:
        Image.new("1", (20_000, 20_000)).save(path)
    with pytest.raises(ValueError, match=r"a\.png: expected a picture"):
        Picture(path).open()


def test_large_pictures_are_shown_smaller() -> None:
    rgb = np.zeros((1500, 2048, 3), np.uint8)
    assert shown(rgb).shape == (750, 1024, 3)
    assert shown_size((240, 320, 3)) == (240, 320)
