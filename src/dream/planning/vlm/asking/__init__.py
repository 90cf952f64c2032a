"""How a model is asked: who, by which client, within which limits, and what is told where no answer comes.

| question | room |
|---|---|
| What can be chosen? | `options`: `Asking`, the options of every planner that asks |
| Who is asked? | `provider`: a maker's model, a server at an address, the stand-in |
| What are models called? | `names`: makers', the stand-in's; what a wrong name may have meant |
| What is asked, and what comes back? | `question`: `Question`, `RawAnswer`, `Answer` |
| Through what is it asked? | `line`: open during one mission; it plays and keeps exchanges |
| How is it asked? | `client`: one request after another; `models`: in which forms |
| What carries it? | `transport`: the loop, and HTTP with replies that are bounded |
| What may it cost? | `budget`: calls and dollars of one mission |
| Where is the answer in what came? | `responses`: in messages of the client; `finding`: in text |
| What if the server refuses? | `refusals`: what may be asked then; `server_words`: what its words mean |
| How is a failure told? | `failures`: its kind, the reason in a line, what to look at |
| What may never leak? | `scrubbing`: keys in texts, headers that are meant for others |
| What is kept on disk? | `cassette`: exchanges |

`client`, `models`, `responses` and `transport` import the libraries of the extra `vlm`. They are imported
when a line to a model is opened, and not before.
"""

from dream.planning.vlm.asking.line import Line, Pending
from dream.planning.vlm.asking.options import Asking
from dream.planning.vlm.asking.question import Answer, Question

__all__ = ["Answer", "Asking", "Line", "Pending", "Question"]
