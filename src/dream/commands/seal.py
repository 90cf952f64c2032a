"""`dream seal`: the key of a sealed test, and what is published of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from dream.commands.console import print_json
from dream.options import First

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dream.evaluation.sealed import Block


@dataclass(frozen=True, slots=True)
class NewKey:
    """Draw the key of a sealed test, and print the commitment of each of its first blocks.

    Publish the commitments before anybody flies; keep the file, and let nobody read it.

    Examples:
        dream seal new sealing.key
    """

    file: tyro.conf.Positional[Path]
    """File to keep the key in, which is not there yet."""
    blocks: First[Annotated[str, tyro.conf.arg(metavar="A..B")]] = "0..9"
    """Numbers of the blocks, of 60 worlds each, whose commitments are printed."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.evaluation.sealed import block_numbers, new_key

        numbers = block_numbers(self.blocks)
        key = new_key(self.file)
        _tell(list(map(key.block, numbers)), json=self.json)
        return 0


@dataclass(frozen=True, slots=True)
class ShowBlocks:
    """Print the commitments of the blocks of a key, or of those that were opened.

    Examples:
        dream seal show sealing.key --blocks 10..19
        dream seal show block-0.txt
    """

    file: tyro.conf.Positional[Path]
    """File with the key, or with opened blocks."""
    blocks: First[Annotated[str | None, tyro.conf.arg(metavar="A..B")]] = None
    """Numbers of the blocks. Unless given, 0, or all in the file."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.evaluation.sealed import block_numbers, read_blocks

        numbers = None if self.blocks is None else block_numbers(self.blocks)
        _tell(read_blocks(self.file, numbers), json=self.json)
        return 0


@dataclass(frozen=True, slots=True)
class OpenBlocks:
    """Write the secrets of some blocks to a file: for who flies them, and for all once they are flown.

    They make these blocks and no others: the blocks after them stay unknown.

    Examples:
        dream seal open sealing.key --blocks 0 --out block-0.txt
    """

    file: tyro.conf.Positional[Path]
    """File with the key."""
    out: First[Path]
    """File to write, which is not there yet."""
    blocks: First[Annotated[str, tyro.conf.arg(metavar="A..B")]] = "0"
    """Numbers of the blocks."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.evaluation.sealed import block_numbers, read_key, write_blocks

        numbers = block_numbers(self.blocks)
        blocks = list(map(read_key(self.file).block, numbers))
        write_blocks(self.out, blocks)
        _tell(blocks, json=self.json)
        return 0


@dataclass(frozen=True, slots=True)
class CheckBlocks:
    """Check that a benchmark flew the worlds that were committed to: all of opened blocks, and no others.

    Examples:
        dream seal check bench/sealed-0a1b2c3d block-0.txt --commitment 5c0f...
    """

    folder: tyro.conf.Positional[Path]
    """Of the benchmark."""
    file: tyro.conf.Positional[Path]
    """File with the key, or with the opened blocks."""
    commitment: First[Annotated[tuple[str, ...], tyro.conf.arg(metavar="HEX ...")]] = ()
    """What was published of each block, in their order."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0; a ValueError says what does not match."""
        from dream.evaluation.results import read_results
        from dream.evaluation.sealed import check_commitments, check_flown

        blocks = check_flown(read_results(self.folder).manifest, self.folder, self.file)
        if self.commitment:
            check_commitments(blocks, self.commitment)
        _tell(blocks, json=self.json)
        if not self.json:
            print(f"{self.folder}: has flown the worlds of these blocks and no others")
        return 0


def _tell(blocks: Sequence[Block], *, json: bool) -> None:
    """Print the commitments, and nothing that is secret."""
    from dream.evaluation.sealed import sealed

    told = sealed(blocks)
    if json:
        print_json(told.as_dict())
        return
    print(f"key {told.key}")
    for number, commitment in told.commitments.items():
        print(f"block {number} {commitment}")


@dataclass(frozen=True, slots=True)
class Seal:
    """Make the key of a sealed test, and tell what is published of it (docs/benchmark.md).

    Examples:
        dream seal new sealing.key
        dream seal show sealing.key --blocks 0..9
    """

    command: (
        Annotated[NewKey, tyro.conf.subcommand("new")]
        | Annotated[ShowBlocks, tyro.conf.subcommand("show")]
        | Annotated[OpenBlocks, tyro.conf.subcommand("open")]
        | Annotated[CheckBlocks, tyro.conf.subcommand("check")]
    )

    def __call__(self) -> int:
        """Exit status of the subcommand."""
        return self.command()
