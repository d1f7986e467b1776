"""Reports: what a `Run` says, for people, for browsers and for programs.

What flows in: a `Run`, or files that hold some. What flows out: text, JUnit, JSON, a page, a badge,
a comparison, a matrix. Rules: a report is made from a run and from nothing else; all reports of one
run give the one judgement of `_summary`.
"""
