"""The live page: a process of its own that reads nights and shows them in a browser.

    hil dashboard nights/

It opens journals read-only and writes nothing but requests (pause, continue, abort, the answer to a question), each
one row that `hil.records.requests` adds and the controller answers. It can be started, killed and started again at
any time. The page itself, in `static/`, has no build step; uPlot (MIT) draws its curves.
"""
