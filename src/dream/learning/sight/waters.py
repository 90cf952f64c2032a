"""What water, light and a camera make of a view, drawn anew each time a picture is learned from.

A view as in air becomes one under water by the revised image formation model (Akkaynak and Treibitz, CVPR
2018), `I = J·L·e^(−a·r) + B·(1 − e^(−b·r))`, with coefficients between those of Jerlov's water types (*Marine
Optics*, 1976), under daylight, lamps or both; then the camera's faults come on top. Each range is wider than
what is met, so that what is met lies within.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from dream.learning.network import import_torch
from dream.learning.sight.pictures import PICTURE
from dream.perception.sight import FARTHEST, GRID, HEIGHT
from dream.sim.water import LUMINANCE, SECCHI

if TYPE_CHECKING:
    from torch import Generator, Tensor

JERLOV = (
    *((0.245, 0.054, 0.033), (0.260, 0.076, 0.062), (0.295, 0.116, 0.116), (0.300, 0.130, 0.170)),
    *((0.330, 0.200, 0.290), (0.250, 0.040, 0.020), (0.400, 0.350, 0.600)),
)
"""Attenuation of red, green and blue per metre: types IB, II, III, 1C and 3C as in `dream.sim.water`, I, and
beyond 5C."""
VISIBILITIES = 2.2, 28.0
"""Metres, evenly between their logarithms."""
EASY = 24.0
"""Metres: the least visibility that a training begins with."""
VANISHED = 0.03
"""Share of the direct light, or of what is seen against the haze, below which a thing is lost."""
FINER = HEIGHT // GRID[0]
"""Pixels of a picture along a pixel of its depth."""
GREY = 0.3
"""Albedo by which that is judged."""
ALTITUDE_OFF = 0.04
"""Of an altitude: its error is a share so large, one sigma."""
UNKNOWN = 0.12
"""Share of the pictures of which neither pose nor altitude is known."""


@dataclass(frozen=True, slots=True, eq=False)
class SightLesson:
    """A batch of pictures and what they show."""

    rgb: Tensor
    """(n, 3, H, W) uint8; H and W are those of the network's input, or less."""
    labels: Tensor
    """(n, H, W) uint8 `Label`s."""
    depth: Tensor
    """(n, h, w) metres along the optical axis on the coarse grid, NaN where there is none to learn."""
    camera: Tensor
    """(n, 4) fx, fy, cx and cy."""
    down: Tensor
    """(n, 3) the camera's right, down and forward axes times the world's downward."""
    altitude: Tensor
    """(n,) metres as an instrument says; NaN where neither pose nor altitude is known."""


@dataclass(slots=True)
class _Draw:
    """Random numbers for a batch, all of one generator."""

    count: int
    generator: Generator

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """(n, *shape) evenly between two numbers; (n, 1, 1, 1) without a shape."""
        torch, shape = import_torch(), shape or (1, 1, 1)
        drawn = torch.rand(self.count, *shape, generator=self.generator, device=self.generator.device)
        return low + (high - low) * drawn

    def log_uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Likewise between their logarithms."""
        return self.uniform(math.log(low), math.log(high), *shape).exp()

    def normal(self, sigma: float, *shape: int) -> Tensor:
        """(n, *shape) about 0."""
        torch, shape = import_torch(), shape or (1, 1, 1)
        return sigma * torch.randn(self.count, *shape, generator=self.generator, device=self.generator.device)

    def chance(self, share: float) -> Tensor:
        """(n, 1, 1, 1) 1 with that probability, else 0."""
        return (self.uniform(0.0, 1.0) < share).float()

    def coin(self, share: float) -> bool:
        """One for the whole batch."""
        return bool(import_torch().rand((), generator=self.generator, device=self.generator.device) < share)


def lesson(
    pictures: npt.NDArray[Any],
    seed: int,
    device: str = "cpu",
    *,
    plain: bool = False,
    shrunk: int = 1,
    hard: float = 1.0,
) -> SightLesson:
    """What a batch of views looks like under water, the same for the same seed and device.

    Args:
        pictures: (n,) of `pictures.PICTURE`.
        seed: Of all that is drawn.
        device: Where to compute.
        plain: Leave out what makes pictures harder to learn from than they come: mirrors, unknown poses.
        shrunk: So many pixels along each side become one.
        hard: 0 where water is no murkier than `EASY`, without snow or blur, and things have the colours of
            their worlds; 1 where all is as hard as it comes.
    """
    torch = import_torch()
    generator = torch.Generator(device=device).manual_seed(seed)
    draw = _Draw(len(pictures), generator)
    told = {name: torch.from_numpy(np.array(pictures[name])).to(device) for name in PICTURE.names or ()}
    if shrunk > 1:
        finer = told["rgb"].permute(0, 3, 1, 2).float()
        finer = torch.nn.functional.avg_pool2d(finer, shrunk).round().to(torch.uint8)
        told |= {"rgb": finer.permute(0, 2, 3, 1), "camera": told["camera"] / shrunk}
        told |= {
            name: told[name][:, shrunk // 2 :: shrunk, shrunk // 2 :: shrunk] for name in ("depth", "labels")
        }
    depth, labels = told["depth"].float(), told["labels"]
    camera, rotation = told["camera"], told["rotation"]
    fx, fy, cx, cy = (camera[:, k].view(-1, 1, 1) for k in range(4))
    right = ((torch.arange(depth.shape[2], device=device) + 0.5).view(1, 1, -1) - cx) / fx
    below = ((torch.arange(depth.shape[1], device=device) + 0.5).view(1, -1, 1) - cy) / fy
    right, below = torch.broadcast_tensors(right, below)
    straight = torch.sqrt(1.0 + right**2 + below**2)
    known = torch.isfinite(depth) & (depth > 0.0)
    z = torch.where(known, depth, torch.zeros_like(depth))
    away = torch.where(known, depth * straight, torch.full_like(depth, 1e3)).unsqueeze(1)
    beam_rays = torch.stack([right, below, torch.ones_like(right)], 1)
    points = torch.einsum("nij,njhw->nihw", rotation, beam_rays * z.unsqueeze(1))
    points = points + told["position"].view(-1, 3, 1, 1)
    up = torch.einsum("nj,njhw->nhw", rotation[:, 2], beam_rays).unsqueeze(1) / straight.unsqueeze(1)

    light = _linear(told["rgb"], device).permute(0, 3, 1, 2).contiguous()
    light = _recoloured(light, labels, points, hard, draw)
    light, left = _under_water(light, away, z, right, below, up, hard, draw)
    light = _snowed(light, hard, draw)
    light = _exposed(light, draw)
    light = _blurred(light, hard, draw)
    edge = (right**2 + below**2).unsqueeze(1) / (right[:, :1, -1:] ** 2 + below[:, -1:, :1] ** 2).unsqueeze(1)
    light = light * (1.0 - draw.uniform(0.0, 0.5) * edge).clamp(0.2, 1.0)
    rgb = _recorded(light, draw)

    gone = known & (left < VANISHED)
    labels = torch.where(gone, torch.zeros_like(labels), labels)
    valid = known & ~gone
    step = FINER
    coarse = torch.where(valid, depth, torch.full_like(depth, math.nan))[
        :, step // 2 :: step, step // 2 :: step
    ]
    altitude = told["altitude"] * (1.0 + draw.normal(ALTITUDE_OFF, 1)[:, 0]).clamp(0.8, 1.2)
    # The world's downward axis, as seen from the camera.
    down = -rotation[:, 2]
    if not plain:
        altitude = torch.where(
            draw.chance(UNKNOWN).flatten() > 0.0, torch.full_like(altitude, math.nan), altitude
        )
        mirrored = draw.chance(0.5).flatten() > 0.0
        rgb = torch.where(mirrored.view(-1, 1, 1, 1), rgb.flip(3), rgb)
        labels = torch.where(mirrored.view(-1, 1, 1), labels.flip(2), labels)
        # The middle pixel of a coarse one is half a pixel off in the mirror, a 60th of a degree.
        coarse = torch.where(mirrored.view(-1, 1, 1), coarse.flip(2), coarse)
        down = torch.where(mirrored.view(-1, 1), down * down.new_tensor([-1.0, 1.0, 1.0]), down)
        turned = camera.clone()
        turned[:, 2] = depth.shape[2] - camera[:, 2]
        camera = torch.where(mirrored.view(-1, 1), turned, camera)
    return SightLesson(rgb, labels, coarse.clamp(max=FARTHEST), camera, down, altitude)


def _linear(rgb: Tensor, device: str) -> Tensor:
    """Linear light of sRGB bytes (IEC 61966-2-1)."""
    torch = import_torch()
    values = torch.arange(256, device=device) / 255.0
    table = torch.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    found: Tensor = table[rgb.int()]
    return found


def _encoded(light: Tensor) -> Tensor:
    """sRGB in [0, 1] of linear light."""
    torch = import_torch()
    light = light.clamp(0.0, 1.0)
    found: Tensor = torch.where(
        light <= 0.0031308, 12.92 * light, 1.055 * light.clamp(min=1e-6) ** (1.0 / 2.4) - 0.055
    )
    return found


def _recoloured(light: Tensor, labels: Tensor, points: Tensor, hard: float, draw: _Draw) -> Tensor:
    """Other colours and brightness for each label; waves and patches that are fixed in the world."""
    count = len(light)
    change = draw.normal(0.35, 4, 3) * draw.uniform(0.0, 1.0, 1, 1)
    change = change + draw.normal(0.35, 4, 1) * draw.uniform(0.0, 1.0, 1, 1)
    factors = (hard * change).exp().gather(1, labels.long().view(count, -1, 1).expand(-1, -1, 3))
    light = light * factors.permute(0, 2, 1).view(light.shape)
    waves = _pattern(points, draw) * draw.uniform(0.0, 0.35) * draw.chance(0.6)
    patches = (_pattern(points, draw) * draw.log_uniform(1.0, 12.0)).tanh() * draw.chance(0.2)
    stain = draw.normal(0.2, 3, 1, 1) + draw.normal(0.25)
    return light * (hard * (waves + patches * stain)).exp()


def _pattern(points: Tensor, draw: _Draw) -> Tensor:
    """(n, 1, H, W) about −2 to 2: bent waves of three lengths, each way round in the world."""
    torch = import_torch()
    pattern = torch.zeros_like(points[:, 0])
    base = draw.log_uniform(0.4, 4.0, 1)
    for octave in range(3):
        along, across = draw.normal(2.3**octave, 2, 3).unbind(1)
        bent = torch.sin(torch.einsum("ni,nihw->nhw", across * base, points))
        wave = torch.einsum("ni,nihw->nhw", along * base, points) + draw.uniform(0.0, 6.3, 1, 1)
        pattern = pattern + torch.sin(wave + 1.5 * bent) / 1.6**octave
    found: Tensor = pattern.unsqueeze(1)
    return found


def _under_water(
    light: Tensor,
    away: Tensor,
    z: Tensor,
    right: Tensor,
    below: Tensor,
    up: Tensor,
    hard: float,
    draw: _Draw,
) -> tuple[Tensor, Tensor]:
    """(n, 3, H, W) linear light at the camera; (n, H, W) the share that is left of what is there."""
    torch = import_torch()
    types = light.new_tensor(JERLOV)
    pick = [
        types[torch.randint(len(JERLOV), (draw.count,), generator=draw.generator, device=light.device)]
        for _ in range(2)
    ]
    mix = draw.uniform(0.0, 1.0, 1)
    a = (pick[0] * mix + pick[1] * (1.0 - mix)) * draw.normal(0.2, 3).exp()
    luminance = (a * a.new_tensor(LUMINANCE)).sum(1, keepdim=True)
    murky, clear = VISIBILITIES
    seen = draw.log_uniform(EASY * (murky / EASY) ** hard, clear, 1)
    a = torch.where(draw.uniform(0.0, 1.0, 1) < 0.06, a * 0.05, a / luminance * SECCHI / seen)
    luminance = (a * a.new_tensor(LUMINANCE)).sum(1).view(-1, 1, 1, 1)
    b = a.mean(1, keepdim=True) * draw.normal(0.25, 3).exp() * draw.uniform(0.6, 1.3, 1)
    a, b = a.view(-1, 3, 1, 1), b.view(-1, 3, 1, 1)

    lamp = draw.chance(0.45)
    dark = draw.chance(0.25) * lamp
    sun = dark * draw.uniform(0.0, 0.1) + (1.0 - dark) * draw.uniform(0.35, 1.2)
    hue = torch.cat([draw.uniform(low, 1.0 if low > 0.1 else 0.5) for low in (0.02, 0.35, 0.15)], 1)
    grey = draw.chance(0.12)
    hue = grey * hue.mean(1, keepdim=True) * draw.normal(0.08, 3, 1, 1).exp() + (1.0 - grey) * hue
    veil = hue / hue.amax(1, keepdim=True) * draw.log_uniform(0.04, 0.5) * (0.3 + 0.7 * sun)

    # A lamp beside the camera, whose beam falls off from its axis and with the square of its distance.
    beside, above = draw.normal(0.25), draw.normal(0.25)
    dx, dy = right.unsqueeze(1), below.unsqueeze(1)
    far = z.unsqueeze(1)
    reach = torch.sqrt((dx * far - beside) ** 2 + (dy * far - above) ** 2 + far**2).clamp(min=0.2)
    off_axis = torch.atan(torch.sqrt((dx - 0.3 * beside) ** 2 + (dy - 0.3 * above) ** 2))
    beam = torch.exp(-0.5 * (off_axis / draw.uniform(0.3, 0.9)) ** 2)
    colour = draw.normal(0.12, 3, 1, 1).exp() * lamp
    lit = sun + colour * (draw.uniform(0.5, 6.0) * beam / reach**2) * torch.exp(-a * reach)

    direct = torch.exp(-a * away.clamp(max=300.0))
    silt = 1.0 + (_clouds(light, 5, draw) - 0.5) * draw.uniform(0.0, 1.2) * draw.chance(0.35)
    haze = 1.0 - torch.exp(-b * silt * away.clamp(max=300.0))
    brighter_above = torch.exp(up * draw.uniform(-0.3, 1.3))
    glow = draw.uniform(0.0, 0.12) * beam * (1.0 - torch.exp(-5.0 * luminance * away.clamp(max=50.0)))
    around = veil * brighter_above * haze + colour * glow
    luma = a.new_tensor(LUMINANCE).view(1, 3, 1, 1)
    seen_by = (GREY * lit * direct * luma).sum(1)
    contrast = seen_by / (seen_by + (around * luma).sum(1) + 1e-4)
    return light * lit * direct + around, torch.minimum((direct * luma).sum(1), contrast)


def _clouds(light: Tensor, cells: int, draw: _Draw) -> Tensor:
    """(n, 1, H, W) smooth noise in [0, 1]."""
    coarse = draw.uniform(0.0, 1.0, 1, cells, cells * 4 // 3)
    resize = import_torch().nn.functional.interpolate
    found: Tensor = resize(coarse, size=light.shape[2:], mode="bilinear")
    return found


def _snowed(light: Tensor, hard: float, draw: _Draw) -> Tensor:
    """Flakes in front of it, sharp ones or, being near, blurred ones."""
    torch = import_torch()
    share = draw.log_uniform(1e-6, 1.2e-3) * draw.chance(0.6 * hard)
    flakes = (draw.uniform(0.0, 1.0, 1, *light.shape[2:]) < share).float()
    flakes = flakes * draw.uniform(0.0, 1.0, 1, *light.shape[2:])
    spot = light.new_tensor([[0.1, 0.4, 0.1], [0.4, 1.0, 0.4], [0.1, 0.4, 0.1]]).view(1, 1, 3, 3)
    flakes = torch.nn.functional.conv2d(flakes, spot, padding=1)
    if draw.coin(0.4):
        flakes = torch.nn.functional.avg_pool2d(flakes, 5, 1, 2) * 6.0
    bright = light.mean((2, 3), keepdim=True) * draw.uniform(0.5, 3.0)
    return light + flakes * bright


def _exposed(light: Tensor, draw: _Draw) -> Tensor:
    """A mean that a camera's exposure gives, and a white balance between none and a grey world."""
    mean = light.mean((1, 2, 3), keepdim=True).clamp(min=1e-4)
    light = light * draw.log_uniform(0.07, 0.4) / mean
    channels = light.mean((2, 3), keepdim=True).clamp(min=1e-4)
    balance = (channels.mean(1, keepdim=True) / channels) ** draw.uniform(0.0, 1.0)
    return light * (balance * draw.normal(0.06, 3, 1, 1).exp()).clamp(0.3, 4.0)


def _blurred(light: Tensor, hard: float, draw: _Draw) -> Tensor:
    """Half of the pictures, in one batch of two, out of focus."""
    torch = import_torch()
    if not draw.coin(0.5 * hard):
        return light
    sigma = float(draw.uniform(0.4, 1.6)[0, 0, 0, 0])
    line = torch.exp(-0.5 * (torch.arange(-3, 4, device=light.device) / sigma) ** 2)
    line = (line / line.sum()).expand(3, 1, 7)
    some = max(1, len(light) // 2)
    conv = torch.nn.functional.conv2d
    soft = conv(light[:some], line.unsqueeze(2), padding=(0, 3), groups=3)
    soft = conv(soft, line.unsqueeze(3), padding=(3, 0), groups=3)
    return torch.cat([soft, light[some:]])


def _recorded(light: Tensor, draw: _Draw) -> Tensor:
    """(n, 3, H, W) uint8: noise of photons and of reading, contrast, and JPEG for some."""
    torch = import_torch()
    light = light.clamp(0.0, 1.2)
    sigma = torch.sqrt(light * draw.uniform(0.0, 2e-3) + draw.uniform(0.0, 1e-4))
    light = light + sigma * draw.normal(1.0, 3, *light.shape[2:])
    shown = ((_encoded(light) - 0.5) * draw.uniform(0.75, 1.3) + 0.5).clamp(0.0, 1.0)
    rgb = (shown ** draw.normal(0.25).exp() * 255.0).round().to(torch.uint8)
    packed = draw.uniform(0.0, 1.0, 1).flatten().tolist()
    quality = draw.uniform(30.0, 95.0, 1).flatten().tolist()
    for k, chance in enumerate(packed):
        if chance < 0.4:
            rgb[k] = torch.from_numpy(_through_jpeg(rgb[k].permute(1, 2, 0).cpu().numpy(), int(quality[k])))
    return rgb


def _through_jpeg(rgb: npt.NDArray[np.uint8], quality: int) -> npt.NDArray[np.uint8]:
    """(3, H, W) of (H, W, 3)."""
    packed = io.BytesIO()
    Image.fromarray(rgb).save(packed, "JPEG", quality=quality)
    with Image.open(packed) as image:
        return np.ascontiguousarray(np.asarray(image).transpose(2, 0, 1))
