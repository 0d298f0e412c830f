"""The live page: a process of its own that reads nights and shows them in a browser.

    hil dashboard nights/

It opens journals read-only and writes nothing but requests (pause, continue, abort, the answer to a question), each
one row that `hil.records.requests` adds and the controller answers. It can be started, killed and started again at
any time.

| file | what it does |
|---|---|
| `curves.py` | a night's curves: its temperatures, and the running averages of its newest collect |
| `facts.py` | what a night's journal and live files say, as the page shows it; the self-calibrations so far |
| `watcher.py` | looks at the nights of a folder once a second and tells every page what changed |
| `access.py` | who may read, who may ask: hosts, token, headers |
| `server.py` | the addresses of the page |
| `static/` | the page itself, without a build step; uPlot (MIT) draws the curves |
"""
