from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3
from dream.sim.render import FAR, Renderer
from dream.sim.render.shading import FADE, encode_table
from dream.sim.water import WATERS, Water
from dream.types import Label
from tests.sim.render.scenes import DOWN, ball, camera, instances, looking, plate, world


def test_flat_ground_seen_from_above_is_as_deep_everywhere_as_the_camera_is_high() -> None:
    seen = Renderer(world()).measure(camera(), SE3(DOWN, np.array([0.3, 0.2, -8.0])))
    np.testing.assert_allclose(seen.depth, 2.0, rtol=1e-5)
    assert (seen.labels == Label.SEABED).all()
    assert (seen.ids == -1).all()


def test_flat_ground_seen_at_a_slant_follows_the_rays() -> None:
    view, pitch = camera(), math.radians(20.0)
    seen = Renderer(world(half=60.0)).measure(view, looking(0.0, 0.0, -8.0, 0.7, pitch))
    # A ray through row v goes down by this much per metre along the optical axis.
    down = math.sin(pitch) + math.cos(pitch) * (np.arange(view.height) + 0.5 - view.cy) / view.fy
    expected = np.where(down > 2.0 / FAR, 2.0 / np.where(down > 0, down, 1.0), np.nan)
    np.testing.assert_allclose(seen.depth, np.broadcast_to(expected[:, None], seen.depth.shape), rtol=1e-4)
    assert ((seen.labels == Label.WATER) == np.isnan(seen.depth)).all()


def test_a_wall_ahead_has_one_depth() -> None:
    wall = world((plate(),), obstacles=instances([0], [0, 5, -8], (30, 1, 30)))
    seen = Renderer(wall).measure(camera(), looking(0.0, 0.0, -8.0, 0.5 * math.pi, 0.0))
    middle = seen.labels == Label.OBSTACLE
    np.testing.assert_allclose(seen.depth[middle], 5.0, rtol=1e-5)
    assert middle[: camera().height // 2].all()


def test_a_sphere_covers_the_pixels_of_its_silhouette() -> None:
    view, radius, distance = camera(), 1.0, 4.0
    one = world((ball(40),), targets=instances([0], [distance, 0, -5], radius))
    seen = Renderer(one).measure(view, looking(0.0, 0.0, -5.0, 0.0, 0.0))
    u, v = np.meshgrid(np.arange(view.width) + 0.5 - view.cx, np.arange(view.height) + 0.5 - view.cy)
    angle = np.arctan(np.hypot(u / view.fx, v / view.fy))
    inside = angle < math.asin(radius / distance)
    # The mesh lies a little inside the sphere, so that the rim may miss a pixel.
    assert (seen.ids[angle < 0.98 * math.asin(radius / distance)] == 0).all()
    assert (seen.ids[~inside] == -1).all()
    np.testing.assert_allclose(seen.depth[view.height // 2, view.width // 2], distance - radius, rtol=5e-3)


def test_a_plate_shows_its_back_only_where_it_is_two_sided() -> None:
    behind = looking(0.0, 5.0, -8.0, -0.5 * math.pi, 0.0)
    for two_sided in (True, False):
        wall = world((plate(two_sided=two_sided),), obstacles=instances([0], [0, 0, -8], 2.0))
        seen = Renderer(wall).measure(camera(), behind)
        assert (seen.labels == Label.OBSTACLE).any() == two_sided


def test_nothing_but_water_above_has_no_depth() -> None:
    seen = Renderer(world()).measure(
        camera(), SE3(DOWN @ np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -8.0]))
    )
    assert np.isnan(seen.depth).all()
    assert (seen.labels == Label.WATER).all()


def test_things_beyond_the_far_plane_are_water() -> None:
    view = camera()
    for distance, found in ((FAR - 0.5, True), (FAR + 0.5, False)):
        wall = world((plate(),), obstacles=instances([0], [0, distance, -5], (3, 1, 2)))
        seen = Renderer(wall).measure(view, looking(0.0, 0.0, -5.0, 0.5 * math.pi, 0.0))
        assert (seen.labels == Label.OBSTACLE).any() == found


def _wall(water: Water, distance: float, color: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    """(17, 17, 3) sRGB of the middle of a wall that faces the camera and not the sun."""
    wall = world(
        (plate(color, two_sided=False),), obstacles=instances([0], [0, distance, -5], (30, 1, 4)), water=water
    )
    frame = Renderer(wall).render(camera(81, 61), looking(0.0, 0.0, -5.0, 0.5 * math.pi, 0.0))
    return frame.rgb[22:39, 32:49]


def test_the_veil_before_a_black_wall_follows_the_formula() -> None:
    water = dataclasses.replace(WATERS["green"], particles=0.0)
    for distance in (2.0, 6.0, FADE * FAR - 0.5):
        expected = encode_table()[(4095 * water.scattered(distance)).astype(int)].astype(float)
        np.testing.assert_allclose(_wall(water, distance, (0, 0, 0))[8, 8], expected, atol=1.5)


def test_direct_light_decays_with_the_length_of_the_ray() -> None:
    veilless = Water("veilless", (0.25, 0.12, 0.06), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0))
    linear = np.array([np.flatnonzero(encode_table() >= level)[0] / 4096 for level in range(256)])
    near, far = (linear[_wall(veilless, d, (160, 160, 160))].mean(axis=(0, 1)) for d in (2.0, 8.0))
    np.testing.assert_allclose(far / near, veilless.direct(6.0), rtol=0.06)


def test_clearer_water_shows_more_contrast_far_away() -> None:
    spread = {}
    for name in ("clear", "coastal", "green", "turbid"):
        water = dataclasses.replace(WATERS[name], particles=0.0)
        frame = Renderer(world(water=water, relief=0.05)).render(camera(), looking(0.0, 0.0, -8.0, 0.3))
        far = (frame.depth > 6.0) & (frame.depth < 9.0)
        spread[name] = frame.rgb[far].astype(float).std(axis=0).sum()
    assert spread["clear"] > spread["coastal"] > spread["turbid"]


def test_the_seabed_has_texture_and_does_not_repeat_within_a_few_metres() -> None:
    rgb = Renderer(world()).render(camera(160, 120), SE3(DOWN, np.array([0.0, 0.0, -7.0]))).rgb.astype(float)
    grey = rgb.mean(axis=2)
    assert grey.std() > 4.0
    # 6 m of ground span the width, so that the 4 m tile comes again after 107 pixels.
    left, right = grey[:, :50].ravel(), grey[:, 107:157].ravel()
    assert np.corrcoef(left, right)[0, 1] < 0.9


def test_ground_beneath_a_boulder_is_darker_than_open_ground() -> None:
    shaded = world((ball(12),), obstacles=instances([0], [0, 0, -9.4], 0.8))
    eye, view = SE3(DOWN, np.array([1.0, 0.0, -7.0])), camera()
    with_boulder, without = Renderer(shaded).render(view, eye), Renderer(world()).render(view, eye)
    points = view.back_project(with_boulder.depth, eye)
    beside = (with_boulder.labels == Label.SEABED) & (np.hypot(points[..., 0], points[..., 1]) < 1.0)
    assert with_boulder.rgb[beside].mean() < 0.93 * without.rgb[beside].mean()
