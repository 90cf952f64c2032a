"""A vision-language model, asked over the wire, decides or advises.

| room | what stands there |
|---|---|
| `paper`, `ranked` | the planners: `Dream` and `Vanilla`; `Ranked` |
| `offline` | the planner behind a model, and what it says of what else could be done |
| `places`, `places_in_space` | what `Ranked` lets a model choose among |
| `ranking_question`, `votes` | how it is asked to rank them, and what the answers say together |
| `prompts`, `pictures`, `heights` | what a model is told and shown |
| `reply` | what its reply must be, and the decision in it |
| `orders` | an operator's words, turned into orders |
| `asking` | who is asked and how, what that may cost, and what is told where no answer comes |
"""

from dream.planning.vlm.asking import Asking
from dream.planning.vlm.asking.names import WIRE_TEST, stands_in
from dream.planning.vlm.paper import Dream, Vanilla
from dream.planning.vlm.ranked import Ranked

__all__ = ["WIRE_TEST", "Asking", "Dream", "Ranked", "Vanilla", "stands_in"]
