"""Tiling textures, made once: sand, stone and caustics as pyramids of ever coarser copies.

A texel is one int64 that holds four channels of eight bits in lanes of sixteen, so that a kernel blends
all four with one multiplication. `_kernels.lane` undoes it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

SAND_SIZE, SAND_METRES = 1024, 4.0
STONE_SIZE, STONE_METRES = 512, 1.6
CAUSTIC_SIZE, CAUSTIC_METRES = 256, 3.1
SLOPE_RANGE = 1.0
"""A slope in a texel is stored as 127.5·(1 + slope / range)."""


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """A square texture and its halvings."""

    texels: Array
    """(T,) int64, all levels one after the other, each row by row."""
    starts: Array
    """(L,) int64, where each level begins."""
    size: int
    """Texels along the side of level 0; a power of two."""
    metres: float
    """Side of one tile in the world."""


def packed(channels: Array) -> Array:
    """int64 texels (...) of four channels (..., 4) in [0, 1]."""
    lanes = np.clip(np.rint(channels * 255.0), 0, 255).astype(np.int64)
    return lanes[..., 0] | lanes[..., 1] << 16 | lanes[..., 2] << 32 | lanes[..., 3] << 48


def pyramid(channels: Array, metres: float) -> Pyramid:
    """All halvings of (S, S, 4) channels in [0, 1]."""
    levels, starts, level = [], [0], channels
    while True:
        levels.append(packed(level).ravel())
        if len(level) == 1:
            break
        starts.append(starts[-1] + len(levels[-1]))
        half = len(level) // 2
        level = level.reshape(half, 2, half, 2, 4).mean(axis=(1, 3))
    return Pyramid(np.concatenate(levels), np.array(starts, np.int64), len(channels), metres)


def spectral_noise(size: int, exponent: float, low: float, high: float, rng: np.random.Generator) -> Array:
    """Tiling noise (size, size) with unit deviation whose amplitude falls as frequency^−exponent.

    Args:
        size: Side, texels.
        exponent: 0 is white, 1 is clouds.
        low: Least cycles per tile.
        high: Most cycles per tile; rolls off smoothly.
        rng: Source of the phases.
    """
    fy, fx = np.fft.fftfreq(size, 1.0 / size)[:, None], np.fft.rfftfreq(size, 1.0 / size)[None, :]
    frequency = np.hypot(fx, fy)
    gain = np.maximum(frequency, 1.0) ** -exponent * np.exp(-((frequency / high) ** 4))
    gain[frequency < low] = 0.0
    noise: Array = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) * gain, s=(size, size))
    noise /= noise.std()
    return noise


def _slopes(height: Array, metres: float) -> tuple[Array, Array]:
    """∂/∂x and ∂/∂y of a tiling height map, in [0, 1] about ½."""
    step = 2.0 * metres / len(height)
    dx = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) / step
    dy = (np.roll(height, -1, axis=0) - np.roll(height, 1, axis=0)) / step
    return 0.5 + 0.5 * dx / SLOPE_RANGE, 0.5 + 0.5 * dy / SLOPE_RANGE


@functools.cache
def sand() -> Pyramid:
    """Brightness, share of shell hash, and slopes along x and y of rippled sand."""
    rng = np.random.default_rng(11)
    line = np.arange(SAND_SIZE) / SAND_SIZE
    warp = spectral_noise(SAND_SIZE, 1.4, 1, 12, rng)
    # Crests wander and fork: the phase is bent by noise, and the ripples die out here and there.
    phase = 2.0 * np.pi * (21.0 * line[None, :] + 7.0 * line[:, None]) + 2.1 * warp
    present = np.clip(0.55 + 0.5 * spectral_noise(SAND_SIZE, 1.5, 1, 10, rng), 0.05, 1.0)
    ripple = present * (np.sin(phase) + 0.28 * np.sin(2.0 * phase + 0.9))
    lumps = spectral_noise(SAND_SIZE, 1.3, 3, 120, rng)
    grain = spectral_noise(SAND_SIZE, 0.25, 90, 420, rng)
    pits = np.clip(spectral_noise(SAND_SIZE, 0.6, 20, 90, rng) - 1.7, 0.0, 1.0)
    height = 0.0105 * ripple + 0.009 * lumps + 0.0009 * grain - 0.02 * pits
    dx, dy = _slopes(height, SAND_METRES)
    # Fragments of shell gather in the troughs.
    chips = spectral_noise(SAND_SIZE, 0.1, 60, 330, rng)
    hash_share = np.clip(2.2 * (chips - 2.25 + 0.22 * (0.3 * lumps - ripple)), 0.0, 1.0)
    dark_chips = np.clip(1.6 * (-chips - 2.5), 0.0, 1.0)
    tone = 0.5 + 0.055 * ripple + 0.05 * lumps + 0.055 * grain - 0.3 * pits - 0.3 * dark_chips
    return pyramid(np.stack([tone, hash_share, dx, dy], axis=-1), SAND_METRES)


@functools.cache
def stone() -> Pyramid:
    """Brightness of rock, brightness of shell, share of rust, and fine grain."""
    rng = np.random.default_rng(12)
    broad = spectral_noise(STONE_SIZE, 1.5, 1, 60, rng)
    fine = spectral_noise(STONE_SIZE, 0.7, 10, 200, rng)
    cracks = np.abs(spectral_noise(STONE_SIZE, 1.2, 3, 90, rng))
    rock = 0.52 + 0.13 * broad + 0.10 * fine - 0.3 * np.exp(-((cracks / 0.12) ** 2))
    line = np.arange(STONE_SIZE) / STONE_SIZE
    rings = np.sin(2.0 * np.pi * 46.0 * line[:, None] + 3.0 * spectral_noise(STONE_SIZE, 1.3, 2, 30, rng))
    growth = np.clip(spectral_noise(STONE_SIZE, 0.8, 12, 120, rng), -2.0, 2.0)
    shell = 0.55 + 0.08 * rings + 0.12 * fine + 0.10 * growth
    rust = 0.5 + 0.33 * spectral_noise(STONE_SIZE, 1.2, 2, 140, rng)
    grain = 0.5 + 0.16 * spectral_noise(STONE_SIZE, 0.5, 30, 250, rng)
    return pyramid(np.clip(np.stack([rock, shell, rust, grain], axis=-1), 0.0, 1.0), STONE_METRES)


@functools.cache
def caustics() -> Pyramid:
    """Light focused by waves, mean ¼ of full scale, in the first channel.

    Parallel rays are bent by a random tiling surface and counted where they land, as light does it.
    """
    rng = np.random.default_rng(13)
    size, rays = CAUSTIC_SIZE, 4 * CAUSTIC_SIZE
    surface = spectral_noise(rays, 2.2, 2, 11, rng)
    step = 1.0 / rays
    bend = 0.0075
    shift_x = bend * (np.roll(surface, -1, axis=1) - np.roll(surface, 1, axis=1)) / (2.0 * step) / 11.0
    shift_y = bend * (np.roll(surface, -1, axis=0) - np.roll(surface, 1, axis=0)) / (2.0 * step) / 11.0
    line = (np.arange(rays) + 0.5) * step
    u = np.floor((line[None, :] + shift_x) * size).astype(np.int64) % size
    v = np.floor((line[:, None] + shift_y) * size).astype(np.int64) % size
    count = np.bincount((v * size + u).ravel(), minlength=size * size).reshape(size, size) / 16.0
    # The sun is no point: its image is smeared over about a texel.
    spectrum = np.fft.rfft2(count)
    fy, fx = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :]
    light = np.fft.irfft2(spectrum * np.exp(-2.0 * np.pi**2 * 0.9**2 * (fx**2 + fy**2)), s=(size, size))
    channels = np.zeros((size, size, 4))
    channels[..., 0] = np.clip(0.25 * light, 0.0, 1.0)
    return pyramid(channels, CAUSTIC_METRES)
