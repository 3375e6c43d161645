"""A robot's log against the scene that was scanned: which footholds are otherwise, and whether the camera sees it.

terrain.py    tops under a point, by rays         touches.py    where feet stood, how high, how loaded
mixed.py      one linear model with evidence      footholds.py  what each foothold is, and which differ
slips.py      feet that slide                     corrected.py  the scene with what was found in it
"""
