"""Install a wheel as a stranger would, outside the clone, and fly with it: `make release-check`.

In an empty environment, from an empty folder, with no variables but PATH and HOME: a mission from the first
compilation to its report, the same without compiling, a picture, a benchmark of one small world, what is said
of an extra that is missing, and the command that adds it. Another user, who may not write where the package
lies, gets kernels of their own. The first tutorial is followed to its end. At last the lowest versions that
the package says to bear.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path

MOST_MB = 15.0
"""Of a wheel."""
NETWORK = (
    "SSL_CERT_FILE",
    "SSL_CERT_DIR",
    "PIP_",
    "HTTP_PROXY",
    "HTTPS_PROXY",
    "NO_PROXY",
    "http_proxy",
    "https_proxy",
)
"""Beginnings of the variables that an installer may need to reach an index; the package itself gets none."""
COMPILES = "compiling"
"""Of the line that a command writes to standard error before it compiles."""
NOBODY = 65534
OLDEST = 11
"""Minor version of the oldest Python that will do."""
UV = Path(".tools/bin/uv").resolve()


@dataclass(frozen=True, slots=True)
class Said:
    """What a command left."""

    status: int
    out: str
    err: str
    wall_s: float
    cpu_s: float


class Failed(Exception):  # noqa: N818 - that is what it says.
    """The wheel is not fit to be released."""


def main() -> int:
    """Exit status 0 where all went well."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument(
        "--pythons",
        nargs="*",
        default=[],
        help="versions such as 3.13, or paths; else the oldest and the newest that are found",
    )
    told = parser.parse_args()
    wheel = told.wheel.resolve()
    try:
        check_contents(wheel)
        pythons = chosen(told.pythons)
        for python in pythons:
            with tempfile.TemporaryDirectory(prefix="dream-release-") as folder:
                Path(folder).chmod(0o755)
                check(wheel, python, Path(folder), lowest=python == pythons[0])
    except Failed as failed:
        print(f"release-check: {failed}", file=sys.stderr)
        return 1
    print(f"release-check: {wheel.name} is fit")
    return 0


def check_contents(wheel: Path) -> None:
    """It is small, and holds the package and nothing that only developers need."""
    size = wheel.stat().st_size / 1e6
    if size > MOST_MB:
        raise Failed(f"{wheel.name}: expected at most {MOST_MB:g} MB, got {size:.1f}")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    stray = [name for name in names if not re.match(r"dream/|dream_auv-[^/]+\.dist-info/", name)]
    stray += [name for name in names if re.search(r"__pycache__|\.nb[ic]$|(^|/)tests?/", name)]
    if stray:
        raise Failed(f"{wheel.name}: expected the package alone, got {', '.join(stray[:5])}")
    print(f"{wheel.name}: {size:.1f} MB, {len(names)} files")


def chosen(told: Sequence[str]) -> list[Path]:
    """The Pythons of those versions or paths; the oldest and the newest that there are where none is told."""
    found = found_pythons()
    if told:
        wanted = []
        for word in told:
            path = found.get(word) or Path(word)
            if not path.is_file():
                raise Failed(f"PYTHONS: expected some of {', '.join(found)}, or paths, got {word}")
            wanted.append(path)
        return wanted
    if not found:
        raise Failed(f"expected Python 3.{OLDEST} or newer with venv on this machine, got none")
    oldest, *others = found.values()
    if not others:
        print(f"only Python {next(iter(found))} is here: no other is tried")
    return [oldest, *others[-1:]]


def found_pythons() -> dict[str, Path]:
    """Those on PATH, and those that pyenv built, by version; the oldest first."""
    built = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = {}
    for minor in range(OLDEST, OLDEST + 20):
        name = f"python3.{minor}"
        on_path = [Path(folder) / name for folder in os.environ["PATH"].split(os.pathsep)]
        for path in (*on_path, *sorted(built.glob(f"3.{minor}.*/bin/{name}"))):
            works = [str(path), "-c", "import ensurepip, venv"]
            if path.is_file() and not subprocess.run(works, check=False, capture_output=True).returncode:
                found[f"3.{minor}"] = path
                break
    return found


def check(wheel: Path, python: Path, folder: Path, *, lowest: bool) -> None:
    """All that the head of this file lists, with one Python.

    Args:
        wheel: What is installed.
        python: By which.
        folder: An empty one, outside the clone.
        lowest: Whether the lowest versions are tried, too.
    """
    version = subprocess.run([python, "--version"], check=True, capture_output=True, text=True).stdout.strip()
    print(f"{version} ({python})")
    place = Place(folder / "env", folder / "empty", folder / "home")
    place.here.mkdir()
    place.home.mkdir()
    made = run([python, "-m", "venv", place.env], place.here, installers())
    pip: list[str | Path] = [
        place.env / "bin/python",
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ]
    installed = run([*pip, wheel], place.here, installers())
    expect(made.status == 0 and installed.status == 0, "an installation", installed)
    size = sum(path.lstat().st_size for path in place.env.rglob("*")) / 1e6
    wall, cpu = made.wall_s + installed.wall_s, made.cpu_s + installed.cpu_s
    print(f"  installed: {wall:.0f} s, {cpu:.0f} CPU s, {size:.0f} MB")

    told = place.dream("--version")
    expect(told.out.split() == ["dream", wheel.name.split("-")[1]], "its version", told)
    first = place.dream("run", "--world", "reef/string")
    expect(first.status == 0 and COMPILES in first.err, "a mission, and a word that it compiles", first)
    (report,) = (place.here / "runs").glob("20*/report.html")
    check_page(report)
    print(f"  first report: {first.wall_s:.0f} s, {first.cpu_s:.0f} CPU s; it said while it was at work:")
    print("".join(f"    {line}\n" for line in first.err.splitlines()), end="")
    again = place.dream("run", "--world", "reef/string")
    expect(again.status == 0 and COMPILES not in again.err, "a mission without compiling", again)
    print(f"  again: {again.wall_s:.0f} s, {again.cpu_s:.0f} CPU s")
    drawn = place.dream("draw", "--world", "reef/string", "--out", "reef.png")
    expect(drawn.status == 0 and (place.here / "reef.png").stat().st_size > 10_000, "a picture", drawn)
    benched = place.dream(
        "bench", "--world", "flat/empty", "--planners", "lawnmower", "--max-steps", "8", "--out", "bench"
    )
    expect(benched.status == 0, "a benchmark", benched)
    check_page(place.here / "bench/report.html")

    lacking = place.dream("run", "uivnav", "--protocol", "dream-v1", "--max-steps", "8")
    command = lacking.err.strip().partition("To add it: ")[2]
    right = (
        f"{place.env}/bin/python -m pip install 'onnxruntime" in command
        and "dream" not in command.split()[-1]
    )
    expect(lacking.status == 2 and right and COMPILES not in lacking.err, "how to add an extra", lacking)
    added = run(["sh", "-c", command], place.here, installers())
    expect(added.status == 0, f"that this adds the extra: {command}", added)
    flown = place.dream("run", "uivnav", "--protocol", "dream-v1", "--max-steps", "8")
    expect(flown.status == 0, "a mission with the extra", flown)
    left = sorted(path.name for path in place.here.iterdir())
    if left != ["bench", "reef.png", "runs"]:
        raise Failed(f"expected nothing but bench, reef.png and runs in its folder, got {', '.join(left)}")
    follows: list[str | Path] = [
        sys.executable,
        "-m",
        "tests.docs.follow",
        place.env / "bin/dream",
        "first-mission",
    ]
    followed = run(follows, Path.cwd(), {"PATH": os.environ["PATH"], "HOME": str(place.home)})
    expect(followed.status == 0, "the first tutorial, followed to its end", followed)
    print(f"  the first tutorial: {followed.wall_s:.0f} s, {followed.cpu_s:.0f} CPU s")
    check_of_another_user(place)
    if lowest:
        check_lowest(wheel, python, folder)


def check_of_another_user(place: Place) -> None:
    """Who may not write where the package lies keeps what was compiled in a place of his own."""
    theirs = Place(place.env, place.here.with_name("theirs"), place.here.with_name("their-home"))
    for path in (theirs.here, theirs.home):
        path.mkdir()
    if os.geteuid() == 0:  # Who may write everywhere.
        for path in (theirs.here, theirs.home):
            os.chown(path, NOBODY, NOBODY)
        theirs = replace(theirs, user=NOBODY)
        try:
            theirs.dream("--version")
        except PermissionError:
            print("  not tried: another user than the installer, who cannot reach this Python")
            return
    else:
        run(["chmod", "-R", "a-w", place.env], place.here, {})
    draw = ("draw", "--world", "reef/string", "--out", "reef.png")
    first = theirs.dream(*draw)
    kept = sorted(theirs.home.rglob(".cache/**/*.nbc"))
    expect(first.status == 0 and bool(kept), "kernels kept for the user", first)
    again = theirs.dream(*draw)
    same = sorted(theirs.home.rglob(".cache/**/*.nbc")) == kept
    expect(again.status == 0 and same, "what was kept to be used", again)
    print(f"  another user, who may not write there: {len(kept)} kernels kept in ~/.cache", end="")
    print(f"; {first.cpu_s:.0f} CPU s, then {again.cpu_s:.0f}")
    run(["chmod", "-R", "u+w", place.env], place.here, {})


def check_lowest(wheel: Path, python: Path, folder: Path) -> None:
    """The lowest versions that it says to bear do."""
    place = Place(folder / "lowest", folder / "empty", folder / "home")
    made = run([UV, "venv", "--quiet", "--python", python, place.env], place.here, installers())
    expect(made.status == 0, "an environment", made)
    lowest: list[str | Path] = [UV, "pip", "install", "--quiet", "--resolution", "lowest-direct", "--python"]
    installed = run([*lowest, place.env, wheel, *requirements(wheel)], place.here, installers())
    expect(installed.status == 0, "an installation of the lowest versions", installed)
    flown = place.dream("run", "--world", "reef/string", "--max-steps", "8")
    expect(flown.status == 0, "a mission with the lowest versions", flown)
    frozen = run([UV, "pip", "freeze", "--python", place.env / "bin/python"], place.here, installers())
    print(f"  the lowest versions do: {', '.join(frozen.out.split())}")


def requirements(wheel: Path) -> list[str]:
    """What it needs beside its extras."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = archive.read(name).decode()
    return re.findall(r"^Requires-Dist: ([^;\n]+)$", metadata, re.MULTILINE)


def check_page(path: Path) -> None:
    """It is whole, and loads nothing."""
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    if not page.whole or not page.title.strip() or page.loads:
        raise Failed(
            f"{path}: expected a whole page that loads nothing, got one that loads {page.loads or 'nothing'}"
        )


class Page(HTMLParser):
    """What a page says of itself."""

    def __init__(self) -> None:
        super().__init__()
        self.whole, self.title, self.loads, self._titled = False, "", list[str](), False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep what it would load."""
        self._titled = tag == "title"
        named = "src" if tag in ("script", "img", "iframe") else "href" if tag == "link" else ""
        self.loads += [
            value for name, value in attrs if name == named and value and not value.startswith("data:")
        ]

    def handle_data(self, data: str) -> None:
        """Keep its title."""
        if self._titled:
            self.title += data

    def handle_endtag(self, tag: str) -> None:
        """See that it ends."""
        self._titled = False
        self.whole = self.whole or tag == "html"


@dataclass(frozen=True, slots=True)
class Place:
    """An installed package, and from where it is used."""

    env: Path
    here: Path
    home: Path
    user: int | None = None

    def dream(self, *words: str) -> Said:
        """Say a command."""
        clean = {"PATH": "/usr/bin:/bin", "HOME": str(self.home)}
        return run([self.env / "bin/dream", *words], self.here, clean, user=self.user)


def installers() -> dict[str, str]:
    """Variables for what installs: how an index is reached."""
    return {name: value for name, value in os.environ.items() if name.startswith(NETWORK)}


def run(words: Sequence[str | Path], here: Path, env: Mapping[str, str], user: int | None = None) -> Said:
    """Say a command, and take its time."""
    began, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        words,
        cwd=here,
        env=env,
        check=False,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        user=user,
        group=user,
        extra_groups=None if user is None else [],
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Said(done.returncode, done.stdout, done.stderr, time.monotonic() - began, cpu)


def expect(right: bool, what: str, said: Said) -> None:
    """Raise where it is not so, with what was said instead."""
    if not right:
        raise Failed(
            f"expected {what}, got exit status {said.status} and:\n{said.out[-2000:]}{said.err[-4000:]}"
        )


if __name__ == "__main__":
    sys.exit(main())
