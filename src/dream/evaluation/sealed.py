"""Sealed tests: worlds drawn from a secret whose hash is published before anybody flies in them.

Whoever keeps the *key* publishes the *commitment* of each *block* of its worlds. Nobody can tune on worlds
that nobody knows, and nobody can exchange worlds that are committed to. A block is made by a secret of its
own, which the key makes: it can be handed over, and shown to all once it was flown, while the blocks after it
stay unknown. Flown worlds are spent, since their results name them; the next block has others.

Each world is drawn by the same lot, its family too, whatever the others are (independent and identically
distributed, as far as nobody can tell HMAC-SHA256 from a random function). That is what
`dream.evaluation.anytime` rests on.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from dream.evaluation.suites import SEALED_FAMILIES, Case

TAG = "dream sealed 1"
"""Begins whatever is hashed here, so that no hash of anything else is one of these."""
WORLDS_OF_BLOCK = 60
"""With thirteen families, one is missing from about every tenth block."""
MOST_BLOCKS = 100
"""Blocks at most of one command, and of a file."""
LAST_BLOCK = 999_999
SEED_BITS = 48
"""Seeds are from 2**48 to 2**49, above all seeds of other suites. With 15 digits each is the same number in
every program that reads the results, be it a spreadsheet."""
MOST_BYTES = MOST_BLOCKS * 256
"""A larger file is refused."""

_KEY = re.compile(r"[0-9a-fA-F]{64}")
_BLOCK = re.compile(r"block (\d{1,6}) of ([0-9a-f]{64}): ([0-9a-f]{64})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Sealed:
    """What a benchmark's folder tells of its sealed worlds: nothing that is secret."""

    key: str
    """Name of the key: a hash of it."""
    commitments: dict[int, str]
    """Of each block, by its number, in ascending order."""

    def as_dict(self) -> dict[str, Any]:
        """For `manifest.json`."""
        return {"key": self.key, "blocks": {str(number): each for number, each in self.commitments.items()}}


@dataclass(frozen=True, slots=True)
class Block:
    """Some worlds of a key, which `secret` makes and nothing else does."""

    number: int
    key: str
    """Name of the key that it is of."""
    secret: bytes = field(repr=False)
    """32 bytes. Whoever has them knows the worlds of this block, and of no other."""

    def cases(self) -> tuple[Case, ...]:
        """Its worlds in the order in which they were drawn."""
        return tuple(self._drawn(number) for number in range(WORLDS_OF_BLOCK))

    def _drawn(self, number: int) -> Case:
        lot = hmac.digest(self.secret, f"{TAG}\nworld {number}".encode(), "sha256")
        # Of 2**64 lots, those that do not divide evenly do not matter.
        family = SEALED_FAMILIES[int.from_bytes(lot[:8]) % len(SEALED_FAMILIES)]
        world = family[int.from_bytes(lot[8:16]) % len(family)]
        return Case(world, (1 << SEED_BITS) + int.from_bytes(lot[16:24]) % (1 << SEED_BITS))

    def commitment(self) -> str:
        """64 hexadecimal digits that stand for these worlds and no others, and tell nothing about them.

        SHA-256 of lines that anybody to whom the secret was shown can write down: see `docs/benchmark.md`.
        """
        return commitment_to(self.cases(), self)

    def written(self) -> str:
        """A line of a file of blocks. It is as secret as the worlds are."""
        return f"block {self.number} of {self.key}: {self.secret.hex()}\n"


def commitment_to(cases: Sequence[Case], block: Block) -> str:
    """What `Block.commitment` would be if these were its worlds."""
    lines = [
        TAG,
        f"key {block.key}",
        f"block {block.number}",
        f"secret {block.secret.hex()}",
        *(f"{case.world} {case.seed} {case.start}" for case in cases),
    ]
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class SealingKey:
    """What all blocks are made from."""

    secret: bytes = field(repr=False)
    """32 bytes that nobody knows but who keeps them."""

    @property
    def name(self) -> str:
        """64 hexadecimal digits by which the key is known, and which tell nothing about it."""
        return hashlib.sha256(f"{TAG}\nname of {self.secret.hex()}\n".encode()).hexdigest()

    def block(self, number: int) -> Block:
        """The block of that number."""
        return Block(number, self.name, hmac.digest(self.secret, f"{TAG}\nblock {number}".encode(), "sha256"))


def sealed(blocks: Sequence[Block]) -> Sealed:
    """What may be told of blocks."""
    return Sealed(blocks[0].key, {block.number: block.commitment() for block in blocks})


def check_commitments(blocks: Sequence[Block], published: Sequence[str]) -> None:
    """Raise a ValueError unless these are the published commitments of the blocks, in their order."""
    if len(published) != len(blocks):
        raise ValueError(
            f"--commitment: expected {len(blocks)}, one for each of the blocks {blocks_told(blocks)}, "
            f"got {len(published)}"
        )
    for block, expected in zip(blocks, published, strict=True):
        if not _KEY.fullmatch(expected):
            raise ValueError(f"--commitment: expected 64 hexadecimal digits, got {expected[:80]}")
        if (got := block.commitment()) != expected.lower():
            raise ValueError(
                f"--commitment: expected {expected.lower()} of block {block.number}, got {got}. These are "
                "other worlds than those that were committed to: of another key, of another block, or of "
                "another version of this package"
            )


def blocks_told(blocks: Sequence[Block] | Sequence[int]) -> str:
    """Numbers of blocks in words, such as 0..3: as --blocks takes them."""
    numbers = [block.number if isinstance(block, Block) else block for block in blocks]
    return str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]}..{numbers[-1]}"


def block_numbers(text: str) -> range:
    """Those that `N` or `A..B` names, both ends included; a ValueError where there are too many."""
    found = re.fullmatch(r"(\d{1,6})(?:\.\.(\d{1,6}))?", text, re.ASCII)
    if not found:
        raise ValueError(
            f"--blocks: expected a number up to {LAST_BLOCK}, or A..B such as 0..3, got {text[:80]}"
        )
    first, last = int(found[1]), int(found[2] or found[1])
    if last < first:
        raise ValueError(f"--blocks: expected the lower number first, got {text}")
    if last - first >= MOST_BLOCKS:
        raise ValueError(f"--blocks: expected at most {MOST_BLOCKS}, got {last - first + 1}")
    return range(first, last + 1)


def new_key(path: Path) -> SealingKey:
    """Draw a key and keep it in a new file that nobody else may read.

    Raises:
        OSError: There is a file already, or it cannot be written.
    """
    key = SealingKey(os.urandom(32))
    _write_secret(path, f"{key.secret.hex()}\n")
    return key


def write_blocks(path: Path, blocks: Sequence[Block]) -> None:
    """Keep blocks in a new file that nobody else may read, for whoever is to fly them and no others.

    Raises:
        OSError: There is a file already, or it cannot be written.
    """
    _write_secret(path, "".join(block.written() for block in blocks))


def read_key(path: Path) -> SealingKey:
    """The key in a file that `new_key` wrote.

    Raises:
        FileNotFoundError: There is none.
        ValueError: It is something else, or others may read it; the message never holds what stands there.
    """
    text = _read_secret(path)
    if _BLOCK.match(text):
        raise ValueError(f"{path}: expected the key itself, got some blocks of one, which make no others")
    return _key_in(path, text)


def read_blocks(path: Path, numbers: range | None) -> tuple[Block, ...]:
    """Blocks of the key in a file, or those that a file of blocks holds; see `write_blocks`.

    Args:
        path: Of either.
        numbers: Which; unless given, the first of a key, and all of a file of blocks.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is neither, others may read it, or a block is not in it; the message never holds what
            stands there.
    """
    text = _read_secret(path)
    if not _BLOCK.match(text):
        key = _key_in(path, text)
        return tuple(map(key.block, numbers or range(1)))
    found = {}
    for line, content in enumerate(text.splitlines(), start=1):
        told = _BLOCK.fullmatch(content)
        if not told:
            raise ValueError(
                f"{path}, line {line}: expected block N of HEX: HEX, as dream seal open writes it, got "
                "something else"
            )
        found[int(told[1])] = Block(int(told[1]), told[2], bytes.fromhex(told[3]))
    every = list(found)
    if len({block.key for block in found.values()}) > 1 or any(b != a + 1 for a, b in pairwise(every)):
        raise ValueError(f"{path}: expected blocks of one key, one after the other, got others")
    missing = [number for number in numbers or () if number not in found]
    if missing:
        raise ValueError(
            f"--blocks: expected some of {blocks_told(every)}, which {path} holds, got {missing[0]}"
        )
    return tuple(found[number] for number in numbers or every)


def check_flown(manifest: Mapping[str, Any], folder: Path, path: Path) -> tuple[Block, ...]:
    """The blocks of a benchmark, which flew their worlds and no others.

    Args:
        manifest: Of the benchmark.
        folder: Of the benchmark.
        path: Of the key, or of its blocks.

    Raises:
        ValueError: It is no sealed test, or another one; or see `read_blocks`.
    """
    told = manifest.get("sealed")
    if told is None:
        raise ValueError(f"{folder}: expected a sealed test, got {manifest['suite']}")
    numbers = list(map(int, told["blocks"]))
    blocks = read_blocks(path, range(numbers[0], numbers[-1] + 1))
    made = sealed(blocks).as_dict()
    for what, one, other in (("key", told["key"], made["key"]), ("blocks", told["blocks"], made["blocks"])):
        if one != other:
            raise ValueError(f"{folder}: {what}: expected {other}, as in {path}, got {one}")
    made_cases = [case.as_dict() for block in blocks for case in block.cases()]
    if manifest["cases"] != made_cases:
        raise ValueError(
            f"{folder}: cases: expected the {len(made_cases)} of {path} in their order, got others"
        )
    return blocks


def _key_in(path: Path, text: str) -> SealingKey:
    text = text.strip()
    if not _KEY.fullmatch(text):
        what = "" if len(text) == 64 else f"{len(text)} characters, "
        kind = "of which some are no such digits" if re.search(r"[^0-9a-fA-F]", text) else "all such digits"
        raise ValueError(
            f"{path}: expected a key of 64 hexadecimal digits, got {what}{kind}. "
            "Keys are made by dream seal new"
        )
    return SealingKey(bytes.fromhex(text))


def _write_secret(path: Path, text: str) -> None:
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise FileExistsError(
            f"{path}: expected no file there yet, got one. A secret is never written over another"
        ) from None
    except OSError as error:
        raise OSError(f"{path}: expected a place that can be written, got none ({error.strerror})") from None
    with open(handle, "w", encoding="ascii") as file:
        file.write(text)
        file.flush()
        os.fsync(handle)


def _read_secret(path: Path) -> str:
    """What a file of secrets holds; nothing of it is ever told."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected a file with a key, got none. dream seal new makes one")
    with path.open("rb") as file:
        mode = os.fstat(file.fileno()).st_mode
        if os.name == "posix" and mode & (stat.S_IRWXG | stat.S_IRWXO):
            raise ValueError(
                f"{path}: expected a file that only its owner may read, got mode {stat.S_IMODE(mode):04o}. "
                f"If nobody else has read it yet: chmod 600 {path}"
            )
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got more")
    if not content.isascii():
        raise ValueError(f"{path}: expected a key of 64 hexadecimal digits, got something that is no text")
    return content.decode("ascii")
