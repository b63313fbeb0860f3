"""The verdict on a prior: useful, of doubtful use, flat or harmful, in one sentence with its evidence."""

import json
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from upslope.evaluation.learner_test import LearnerTest
from upslope.evaluation.signs import Signs

Word = Literal["useful", "doubtful", "flat", "harmful"]


@dataclass(frozen=True, eq=False, repr=False)
class Verdict:
    """What a prior is worth on a family's fresh tasks.

    Attributes:
        family: name of the family.
        signs: what its policy and potential do.
        test: learners with and without it; None if no learner was trained.
    """

    family: str
    signs: Signs
    test: LearnerTest | None

    @property
    def word(self) -> Word:
        """The verdict in one word.

        "useful" needs learners: shaped ones are ahead of unshaped ones and of a constant, and both 95 % intervals leave
        out zero. "harmful": they are behind unshaped ones in the same sense. "flat": Φ is nearly constant.
        """
        if self.signs.is_flat:
            return "flat"
        if self.test is None:
            return "doubtful"
        over_none, over_constant = self.test.gain("unshaped"), self.test.gain("constant")
        if over_none.high < 0:
            return "harmful"
        return "useful" if over_none.low > 0 and over_constant.low > 0 else "doubtful"

    @property
    def sentence(self) -> str:
        """The verdict in one sentence, and what to try if it is not useful."""
        beginning = {
            "useful": "Useful",
            "doubtful": "Of doubtful use",
            "flat": "Flat",
            "harmful": "Harmful",
        }[self.word]
        return f"{beginning}: {self._evidence()}{self._advice()}"

    def _evidence(self) -> str:
        signs = self.signs
        if self.test is None:
            return (
                f"no learner was trained; the greedy policy has a mean return of {signs.greedy.mean():.4g} on fresh "
                f"tasks, random actions {signs.random.mean():.4g}"
            )
        shaped, unshaped, constant = (self.test.areas(arm).mean() for arm in ("shaped", "unshaped", "constant"))
        return (
            f"over the first {self.test.updates[-1]:,} updates a shaped {self.test.learner.upper()} has a mean return "
            f"of {shaped:.4g}, unshaped {unshaped:.4g} (difference {self.test.gain('unshaped')}), with a "
            f"constant potential {constant:.4g} (difference {self.test.gain('constant')})"
        )

    def _advice(self) -> str:
        if self.word == "useful":
            return "."
        if self.word == "flat":
            return (
                f"; Φ varies by {self.signs.spread:.3g} around {self.signs.level:.4g}. Train for more iterations, and "
                "check that random actions ever see different rewards."
            )
        if self.signs.floor_share > 0.2:
            return (
                f"; its own policy is no better than random on {self.signs.floor_share:.0%} of the tasks. Train for "
                "more iterations or with wider layers, and check that observations show which task it is."
            )
        if self.word == "harmful":
            return ". Check that it was trained on this family, with this γ and these rewards."
        return ". Give the learners more updates or tasks, or train the prior for more iterations."

    def __str__(self) -> str:
        signs = self.signs
        low, middle, high = np.percentile(signs.greedy, [10, 50, 90])
        rows = {
            "greedy": f"median {middle:.4g} of {len(signs.greedy)} fresh tasks, 10 to 90 %: {low:.4g} to {high:.4g}",
            "random": f"median {np.median(signs.random):.4g}; not beaten on {signs.floor_share:.0%} of the tasks",
            "V at the start": f"{signs.start_value.mean():.4g}; the discounted return is {signs.discounted.mean():.4g}",
            "TD error": f"{signs.td_error:.3g}, where Φ varies by {signs.spread:.3g}",
            "Φ along success": "no episode to show it" if signs.rise is None else f"rank correlation {signs.rise:.2f}",
            "level of Φ": f"{signs.level:.4g}; for it alone a step pays {signs.drip:.3g}",
        }
        return "\n".join([self.sentence, *(f"  {name:<16} {text}" for name, text in rows.items())])

    def __repr__(self) -> str:
        return f"Verdict(on {self.family!r}: {self.sentence})"

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers and text, for JSON."""
        content: dict[str, Any] = {"family": self.family, "verdict": self.word, "sentence": self.sentence}
        content["signs"] = {name: _plain(value) for name, value in vars(self.signs).items()} | {
            "floor_share": self.signs.floor_share
        }
        if self.test is not None:
            content["learners"] = {
                "learner": self.test.learner,
                "updates": _plain(self.test.updates),
                "returns": {arm: _plain(values) for arm, values in self.test.returns.items()},
                "gain_over_unshaped": asdict(self.test.gain("unshaped")),
                "gain_over_constant": asdict(self.test.gain("constant")),
            }
        return content

    def to_json(self) -> str:
        """`to_dict` as JSON."""
        return json.dumps(self.to_dict(), indent=1) + "\n"


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
