"""The mechanistic simulator: tropisms, growth and stiffening, with constants fitted to tracks.

Effects that were found later extend it. Its folder keeps what was fitted and the list of effects apart; they are put
together when it is read, so that a further effect can be added to both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.extended import TEMPERATURE, change_of, law_of, noise_of
from flora_lab.simulator.growing import DataRange, GrowingSimulator, read_noise, read_prior, read_range
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.law import Law
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.store import INFO_FILE, Extension, Stored
from flora_lab.simulator.terms import NEUTRAL, ExtendedLaw
from flora_lab.simulator.tropism import TropismLaw


class RodSimulator(GrowingSimulator):
    """The mechanistic simulator.

    Args:
        lamps: where they hang.
        prior, noise, shown, step_s: see :class:`flora_lab.simulator.growing.GrowingSimulator`; as they were fitted,
            without the extensions.
        extensions: effects that its plants have beside, in their order.
        usual_temperature_c: of the runs that it was fitted to, degrees Celsius; where it is not known, or nobody tells
            how warm it is, plants do not follow the temperature.
        where: to name in errors.

    Raises:
        BadInput: see :func:`flora_lab.simulator.extended.change_of`.
    """

    kind: ClassVar[str] = "mechanistic"

    def __init__(
        self,
        lamps: LampsSection,
        prior: Prior,
        noise: DriveNoise,
        shown: DataRange,
        step_s: float = STEP_S,
        *,
        extensions: Sequence[Extension] = (),
        usual_temperature_c: float | None = None,
        where: str = "extended simulator",
    ) -> None:
        change = change_of(extensions, where)
        law, mean = law_of(lamps, change), prior.mean + change.traits
        super().__init__(law, Prior(mean, prior.covariance), noise_of(noise, change, law, mean), shown, step_s)
        self.lamps = lamps
        self.extensions = tuple(extensions)
        self.usual_temperature_c = usual_temperature_c
        self.added_traits = change.traits
        self._fitted_prior, self._fitted_noise = prior, noise

    @property
    def terms(self) -> Array:
        """Of its extensions, see :mod:`flora_lab.simulator.terms`."""
        return self.law.terms if isinstance(self.law, ExtendedLaw) else NEUTRAL

    def extended(self, extensions: Sequence[Extension]) -> RodSimulator:
        """The same simulator with further effects.

        Raises:
            BadInput: see the class.
        """
        return self._with((*self.extensions, *extensions))

    def with_typical(self, moved: Array) -> RodSimulator:
        """The same simulator, with its effects, of plants of which another is typical.

        Args:
            moved: what that one has more than the one before, in logarithms of its constants, shape (9,).
        """
        prior = Prior(self._fitted_prior.mean + moved, self._fitted_prior.covariance)
        return self._with(self.extensions, prior)

    def without_extensions(self) -> RodSimulator:
        """The simulator as it was fitted."""
        return self._with(())

    def _with(self, extensions: Sequence[Extension], prior: Prior | None = None) -> RodSimulator:
        return RodSimulator(
            self.lamps,
            self._fitted_prior if prior is None else prior,
            self._fitted_noise,
            self.shown,
            self.step_s,
            extensions=extensions,
            usual_temperature_c=self.usual_temperature_c,
        )

    def _law_during(self, covariates: Mapping[str, Array]) -> Law:
        told_c = covariates.get(TEMPERATURE)
        if told_c is None or self.usual_temperature_c is None or not isinstance(self.law, ExtendedLaw):
            return self.law
        warmer_c = np.asarray(told_c, dtype=np.float64) - self.usual_temperature_c
        return self.law.when(np.where(np.isfinite(warmer_c), warmer_c, 0.0))

    def _at_start(self, memory: Array) -> Array:
        return ExtendedLaw.at_start(memory) if isinstance(self.law, ExtendedLaw) else memory

    def weights(self) -> dict[str, Array]:
        return {"trait_mean": self._fitted_prior.mean, "trait_covariance": self._fitted_prior.covariance}

    def scales(self) -> dict[str, Any]:
        lamps = {"lamp_distance_cm": self.lamps.distance_cm, "lamp_height_cm": self.lamps.height_cm}
        typical = dict(zip(self.law.traits, np.exp(self._fitted_prior.mean).tolist(), strict=True))
        fitted = {"noise": self._fitted_noise.as_dict(), "typical": typical}
        usual = {} if self.usual_temperature_c is None else {"usual_temperature_c": self.usual_temperature_c}
        return lamps | usual | super().scales() | fitted

    @staticmethod
    def from_stored(stored: Stored) -> RodSimulator:
        """A simulator from its folder.

        Raises:
            BadInput: something is missing, or cannot be a plant's; or see the class.
        """
        is_told = "usual_temperature_c" in stored.info.scales
        return RodSimulator(
            LampsSection(stored.scale("lamp_distance_cm"), stored.scale("lamp_height_cm")),
            read_prior(stored, len(TropismLaw.traits)),
            read_noise(stored),
            read_range(stored),
            stored.info.step_s,
            extensions=stored.info.extension,
            usual_temperature_c=stored.scale("usual_temperature_c") if is_told else None,
            where=str(stored.path / INFO_FILE),
        )
