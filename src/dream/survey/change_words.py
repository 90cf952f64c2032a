"""How a comparison of two surveys is put into words, the same on a terminal and on its page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dream.survey.comparison import Comparison, Difference, PatchChange, Verdict
from dream.survey.fates import Missing
from dream.survey.numbers import UNITS, named, number, places, typeset
from dream.survey.products import words
from dream.survey.products.words import CLUMPS, FIRST, meaning
from dream.survey.survey import DAYS_A_YEAR
from dream.types import Target

CHANGED: tuple[Verdict, ...] = ("loss", "gain", "mixed")
"""Verdicts of patches that are called changed."""
TOLD = 3
"""Changed patches of which the summary tells what was found in them; a table tells it of all."""
SHORTEST = 0.9
"""Years between two surveys below which no rate is told: of a season it is none of a year."""
NEAR_A_YEAR = 0.04
"""Years, two weeks, by which a time may differ from whole years and be told as such."""
DAYS_A_MONTH = DAYS_A_YEAR / 12.0
NAMED = 8
"""Patches of one verdict that the summary lists by their numbers, at most."""

_CALLED: dict[Verdict, tuple[str, str]] = {
    "loss": ("is called a loss", "are called a loss"),
    "gain": ("is called a gain", "are called a gain"),
    "mixed": ("is called mixed, with both losses and gains", "are called mixed, with both losses and gains"),
    "no change shown": ("shows no change", "show no change"),
    "not comparable": ("could not be compared", "could not be compared"),
}
"""Of one, and of several."""
_WENT = {"found": "the number found", "covered": "covered ground", "target_area": "target area"}


def difference_cells(one: Difference) -> tuple[str, str, str]:
    """What it was and is, by how much it changed, and the interval of that."""
    if meaning(one.name).share:
        return (
            f"{one.before:.0%} → {one.after:.0%}",
            f"{100.0 * one.change:+z.0f} points",
            f"{100.0 * one.low:z.0f} to {100.0 * one.high:z.0f} points",
        )
    unit, digits = UNITS.get(one.unit, one.unit), places(max(abs(one.low), abs(one.high)))
    share = f" ({one.change / one.before:+z.0%})" if one.before > 0.0 else ""
    return (
        f"{number(one.before)} → {number(one.after)} {unit}".strip(),
        f"{one.change:+z.{digits}f}{share}",
        f"{one.low:z.{digits}f} to {one.high:z.{digits}f}",
    )


def patch_rows(patch: PatchChange) -> Iterator[tuple[str, tuple[str, str, str], float]]:
    """Name, cells as those of a difference, and p, of each figure of a patch."""
    for name, sign, of in (("gone", -1.0, patch.gone), ("come", 1.0, patch.come)):
        if of is not None:
            low, share, high = (f"{sign * one:+z.0%}" for one in (of.low, of.share, of.high))
            yield name, (f"{of.bare} of {of.of}", share, f"{low} to {high}"), of.p
    for one in patch.differences:
        yield one.name, difference_cells(one), one.p


def a_year(one: Difference, years: float) -> str:
    """By how much it changed in a year on average, and the interval of that; empty of shares, and where less
    than `SHORTEST` passed."""
    if years < SHORTEST or meaning(one.name).share:
        return ""
    digits = places(max(abs(one.low), abs(one.high)) / years)
    rate, low, high = (f"{value / years:z.{digits}f}" for value in (one.change, one.low, one.high))
    return f"{rate} ({low} to {high}) {UNITS.get(one.unit, one.unit)}".strip()


def seen_by_both(comparison: Comparison) -> float:
    """Share of the ground that either saw."""
    either = comparison.comparable + comparison.only_a + comparison.only_b
    return comparison.comparable / either if either > 0.0 else 0.0


def summary(comparison: Comparison) -> list[str]:
    """What changed and how sure that is, in a few paragraphs for whoever reads nothing else."""
    if comparison.withheld:
        return [
            "Nothing shows how the two surveys lie on each other: little of what there was is still there, "
            "or an origin is off, or they are of different ground. So no ground is compared, and there is no "
            "verdict. What each survey tells of all that it saw itself does not hang on that.",
        ]
    if comparison.comparable <= 0.0:
        return ["The two surveys looked at no ground in common: what changed cannot be told from them."]
    numbered = list(enumerate(comparison.patches, start=1))
    lines = [_verdicts(comparison, numbered)]
    changed = [(k, patch) for k, patch in numbered if patch.verdict in CHANGED]
    surest = sorted(changed, key=lambda one: one[1].p or 0.0)[:TOLD]
    for k, patch in sorted(surest, key=lambda one: one[0]):
        where = "it" if len(numbered) == 1 else f"{_pieces(comparison)[0]} {k}"
        lines.append(f"In {where}, {_found_in(patch)}")
    if len(changed) > TOLD:
        lines.append("The table tells of the others.")
    if all(one.before <= 0.0 and one.after <= 0.0 for one in comparison.differences):
        lines.append("On ground that both saw, neither shows any target.")
    lines.append(
        f"Both surveys looked at {number(comparison.comparable)} m², "
        f"{_percent(seen_by_both(comparison))} of the ground that either saw; of the rest nothing is told."
    )
    how_sure = []
    if any(patch.p is not None for patch in comparison.patches):
        how, those = comparison.comparing, _pieces(comparison)[1]
        how_sure.append(
            f"How sure this is: of {those} that stayed as they were, at most {_percent(how.level)} are "
            f"called changed by mistake; of those called changed, at most {_percent(how.false)} are mistakes."
        )
    if any(patch.verdict == "no change shown" for patch in comparison.patches):
        how_sure.append("Where no change is shown, there may still be one: the intervals say how large.")
    return [*lines, " ".join(how_sure)] if how_sure else lines


def limits(comparison: Comparison) -> list[str]:
    """What the figures and verdicts do not say."""
    lines = [
        "Only ground that both surveys saw is compared, patch by patch and on the whole. Those figures are "
        "not those of either survey's own report, and say nothing of ground that one of them did not see.",
        "What each survey tells of all that it saw is set side by side as well. It differs too where one of "
        "them saw more. Its intervals take the errors of the two for independent, which makes them wide and "
        "its p large: on simulated reefs they held the true change in 398 of 400 cases.",
        f"A verdict is that of one {_pieces(comparison)[0]}, from its sharpest test, held against how many "
        "tests there are. Of the whole there is no verdict: each figure has its own p, which says how often "
        "two surveys of ground that has not changed differ by as much.",
        "Intervals are 95 % intervals of the change: in one case of twenty the true change lies outside.",
        "No change shown does not say that there was none. The interval says how much there may have been.",
    ]
    if comparison.a.target is Target.WRECK:
        lines.append(
            "A wreck is compared by the area of its outlines on the map alone. By how much two surveys of an "
            "unchanged one differ was not measured but guessed wide, so that small changes do not show."
        )
    else:
        lines += [
            CLUMPS,
            "What is gone and come is less than what died and settled, as a neighbour often covers the "
            "place: of a fifth that died in simulated reefs 14 % showed. Deaths that others hide, and "
            "settling on others, are not told.",
            "Where fewer than some 70 individuals of a patch were found in two frames, the loss of a fifth "
            "may not show.",
            "Where the positions within one survey err against each other by more than a few centimetres, "
            "individuals stand beside themselves, which looks like deaths and arrivals.",
            "What surveys of unchanged ground miss was measured on simulated reefs, with one camera and "
            "altitude, and with labels that are better than a detector's. How much outlines and areas of the "
            "map err, which tell of patches of few individuals, was guessed wide.",
        ]
    lines.append(
        "The later survey is laid on the cells of the earlier one. The other way round figures change their "
        "signs, and their size by up to some percent."
    )
    return lines


def _pieces(comparison: Comparison) -> tuple[str, str]:
    """What verdicts are of: one, and several."""
    return ("outline", "outlines") if comparison.a.target is Target.WRECK else ("patch", "patches")


def _verdicts(comparison: Comparison, numbered: Sequence[tuple[int, PatchChange]]) -> str:
    one, several = _pieces(comparison)
    if not numbered:
        return f"Neither survey shows a {one}, and there is no verdict."
    parts = []
    for verdict, (singular, plural) in _CALLED.items():
        those = [k for k, patch in numbered if patch.verdict == verdict]
        if not those:
            continue
        if len(those) == len(numbered):
            every = {1: f"The only {one}", 2: f"Both {several}"}.get(
                len(those), f"All {len(those)} {several}"
            )
            return f"{every} {plural if len(those) > 1 else singular}."
        which = ""
        if verdict in CHANGED and len(those) <= NAMED:
            which = f" (number{'s' if len(those) > 1 else ''} {_listed([str(k) for k in those])})"
        parts.append(f"{len(those)} {plural if len(those) > 1 else singular}{which}")
    return f"Of {len(numbered)} {several}, {_listed(parts)}."


def _found_in(patch: PatchChange) -> str:
    gone, come = patch.gone, patch.come
    if gone is None or come is None:
        return f"{_listed([_went(one) for one in patch.differences])}."
    lines = []
    if patch.verdict != "gain":
        lines.append(
            f"{gone.bare} of the {gone.of} individuals that were found before are gone, with bare ground in "
            f"their place. That is {_beyond(gone)} more than surveys of unchanged ground lose."
        )
    if patch.verdict != "loss":
        lines.append(
            f"{come.bare} of the {come.of} individuals that were found after stand where the ground was "
            f"bare. That is {_beyond(come)} more than surveys of unchanged ground gain."
        )
    lines += [f"Its {_went(one)}." for one in patch.differences if one.name == "covered"]
    return " ".join(lines)


def _beyond(of: Missing) -> str:
    return f"{_percent(of.share)} ({100.0 * of.low:.0f} to {_percent(of.high)})"


def headlines(comparison: Comparison) -> list[Difference]:
    """The figures that stand first, in the order of `FIRST`."""
    of = {one.name: one for one in comparison.measures}
    return [of[name] for name in FIRST if name in of]


def direction(one: Difference) -> str:
    """What the interval of a change says."""
    return "more" if one.low > 0.0 else "less" if one.high < 0.0 else "no change shown"


def later(years: float) -> str:
    """How much later one survey is than another, such as "one year later"."""
    way, years = ("later", years) if years >= 0.0 else ("earlier", -years)
    whole = round(years)
    if whole >= 1 and abs(years - whole) < NEAR_A_YEAR:
        return f"{words.years(float(whole))} {way}"
    if years >= 2.0:
        return f"{years:.1f} years {way}"
    days = years * DAYS_A_YEAR
    units = (
        (days / DAYS_A_MONTH, "months"),
        (days, "days"),
        (24.0 * days, "hours"),
        (1440.0 * days, "minutes"),
    )
    told = next((f"{count:.0f} {unit} {way}" for count, unit in units if count >= 2.0), "")
    return told or "at the same time"


def _went(one: Difference) -> str:
    unit, name = UNITS.get(one.unit, one.unit), _WENT.get(one.name, named(one.name))
    before, after = (f"{number(value)} {unit}".strip() for value in (one.before, one.after))
    share = f"{100.0 * one.change / one.before:+z.0f} %" if one.before > 0.0 else ""
    if before == after:
        return f"{name} is {before} in both"
    return f"{name} went from {before.removesuffix(f' {unit}')} to {after}" + f" ({typeset(share)})" * bool(
        share
    )


def _percent(share: float) -> str:
    return typeset(f"{share:.0%}")


def _listed(parts: Sequence[str]) -> str:
    """Such as "a, b and c"."""
    return " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1])))
