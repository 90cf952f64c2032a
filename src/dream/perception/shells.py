"""Labels without a model: light shells on a liner, the wall around it and pipes in front of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dream.types import BoolArray, Float32Array, Label, UInt8Array

_LOG = np.log(np.arange(256, dtype=np.float32) + 1.0)
