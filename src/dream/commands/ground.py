"""Options of the commands that fly: where on earth the ground is, and what an earlier survey knows of it."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dream.options import First
from dream.planning import AnyPlanner, Belief, planner_name

if TYPE_CHECKING:
    from dream.geometry import Bounds
    from dream.mapping.prior import Prior
    from dream.protocol import SurveyProtocol
    from dream.sim.world import World
    from dream.survey import Survey
    from dream.survey.site import Site

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Ground:
    """Where it is, and what is known of it."""

    site: First[Path | None] = None
    """File with name, latitude and longitude of the map's origin; heading_deg, datum, datum_offset and
    uncertainty may be left out. The run keeps it, and all that is seen, for `dream survey`."""
    from_survey: str | None = None
    """An earlier survey of the same ground, to plan with: its number in the archive, its file, or the folder
    of its run. The planner goes first to what that survey found."""
    archive: str | None = None
    """Archive in which `--from-survey` looks: its path, or a postgresql:// URL. Unless given, the one that
    DREAM_ARCHIVE names, else surveys.gpkg."""

    def where(self) -> Site | None:
        """By `--site`; the file is read.

        Raises:
            FileNotFoundError: There is none.
            ValueError: It does not say a site; or what the archive needs is not installed.
        """
        if self.from_survey is not None:
            from dream.commands.survey.sources import check_archive

            check_archive(self.archive)
        from dream.survey.site import read_site

        return None if self.site is None else read_site(self.site)

    def known(
        self,
        site: Site | None,
        planner: AnyPlanner,
        area: Bounds,
        protocol: SurveyProtocol,
        world: World | None,
    ) -> Known:
        """What is known of the ground before a mission; what is taken for granted of a survey is warned of.

        Args:
            site: As `where` says.
            planner: Who is told; one that cannot use a survey is warned of.
            area: To survey, in the map.
            protocol: By which it is mapped.
            world: That is simulated; None where the water is real.

        Raises:
            FileNotFoundError: There is no such survey.
            ValueError: It is damaged, or of another place, kind of target or time.
            OSError: The archive cannot be reached.
        """
        if self.from_survey is None:
            return Known(site)
        from dream.commands.survey.sources import found
        from dream.evaluation.runner import labelled_in
        from dream.survey.prior import frames_told, prior_of
        from dream.types import Target

        survey = found(self.from_survey, self.archive)
        target = Target.ANY if world is None else labelled_in(world)
        now = datetime.now(UTC) if world is None else _in_the_year_of(world, survey)
        prior = prior_of(survey, area, protocol.cell, target=target, site=site, now=now)
        logger.warning("--from-survey: %s", frames_told(survey, site))
        if not isinstance(planner, Belief):
            logger.warning("--from-survey: %s cannot use it and flies as without it", planner_name(planner))
        return Known(site, prior, self.from_survey)


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known of the ground before a mission."""

    site: Site | None = None
    """Where on earth it is; None where nobody says."""
    prior: Prior | None = None
    """What an earlier survey holds of it, on the cells of the map; None where there is none."""
    given: str | None = None
    """What that survey was named by."""

    def config(self) -> dict[str, Any]:
        """What `config.json` says of it."""
        return {} if self.prior is None else {"from_survey": {"given": self.given, **self.prior.as_dict()}}

    def keep(self, folder: Path) -> None:
        """Leave it in the folder of the run, where `dream survey` and `dream replay` find it."""
        from dream.recording import PRIOR
        from dream.survey.site import write_site

        if self.prior is not None:
            self.prior.save(folder / PRIOR)
        if self.site is not None:
            write_site(self.site, folder / "site.json")


def _in_the_year_of(world: World, survey: Survey) -> datetime | None:
    """When a mission in that world is flown, in the years of the survey; None in no later year."""
    from dream.sim.years import years_on
    from dream.survey.survey import DAYS_A_YEAR

    years = years_on(world.name)
    return survey.began + timedelta(days=DAYS_A_YEAR * (years - survey.years_on)) if years else None
