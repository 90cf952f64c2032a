"""Can a model read our map? Questions about maps, with answers that can be computed.

What it does: `make_questions` gives 200 multiple-choice questions, 25 of each of eight kinds, about maps
of simulated worlds that are drawn as the planners draw them. `Score` counts what a model answered and says
in words what that means.

A question shows one picture, `map`, and asks in one of these sentences, followed by a line
`Answer with one of: A, B, C.` with the answers in the order of the reply's schema:

| kind | sentence | answers |
|---|---|---|
| nearest | Which mark is nearest to the robot, in a straight line? | 1, 2, … |
| unexplored | Which mark has the most white ground within 3 m of it? | 1, 2, … |
| boundary | Which mark has a place within 2 m of it where green touches white? | 1, 2, … |
| blocked | To which mark is the straight line from the robot blocked by black or dark green? | 1, 2, … |
| heading | Towards which point of the compass does the robot head? | east, northeast, … (8) |
| enclosed | Is the target region nearest to mark K fully enclosed, so that none of its green touches white? Green with gaps of less than 2 m is one region. | yes, no |
| point | What is at the point x = X m, y = Y m of the map? | target, explored, unexplored, solid |
| explored | How much of the whole area is explored, that is, not white? | less than 20 %, 20 to 40 %, 40 to 60 %, more than 60 % |

K is a mark's number; X and Y are written with %g, such as 3.5 or -12. Five to nine marks stand on every map.
The constants of `reading` say by how much an answer is right. Answers take turns, so that no number and no
word is right more often than another: who always gives the first one scores at chance.
"""  # noqa: E501 - a table's row cannot be broken.

from dream.evaluation.probe.page import write_page
from dream.evaluation.probe.questions import KINDS, QUESTIONS, MapQuestion, make_questions
from dream.evaluation.probe.score import READS, READS_KIND, Reply, Score, Tally

__all__ = [
    "KINDS",
    "QUESTIONS",
    "READS",
    "READS_KIND",
    "MapQuestion",
    "Reply",
    "Score",
    "Tally",
    "make_questions",
    "write_page",
]
