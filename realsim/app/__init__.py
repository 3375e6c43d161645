"""`realsim app`: the commands as a page on this machine, for those who prefer looking to typing.

guard.py     who may ask: this machine, with a token    work.py      a command that runs, its progress and result
actions.py   what can be done with what is recognised   preview.py   pictures and points of it
gallery.py   earlier results                            page.py      the page      server.py   serves it
"""
