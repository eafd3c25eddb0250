"""What files may hold that meshio passes over, so that the surface is another one.

Of parts some are lost or stand in wrong places, and nothing tells of it: such files are refused.
"""

import re
from collections import Counter

__all__ = ["KINDS", "passed_over"]

ONCE = {  # what may stand in a file once: of several meshio takes one, or mixes them up
    "dat": rb"^[ \t]*ZONE\b",
    "dato": rb"^\$+COOR",
    "inp": rb"^[ \t]*\*(?:NODE(?=[ \t]*(?:,|\r|$))|PART\b|INSTANCE\b)",
    "mdpa": rb"^[ \t]*Begin Nodes\b",
    "post": rb"^\$+COOR",
    "su2": rb"^[ \t]*NPOIN\b",
    "tec": rb"^[ \t]*ZONE\b",
    "vtu": rb"<Piece\b",
}
NASTRAN = (  # points in a system of coordinates, by commas, in columns of 8 and of 16
    rb"^[ \t]*INCLUDE\b.*|"
    rb"^[ \t]*(?:GRID|GRDSET)\*?[ \t]*,[^,\n]*,[ \t]*0*[1-9].*"
    rb"|^(?= *(?:GRID|GRDSET)\b(?!\*))[^,\n]{16}[ 0]{0,7}[1-9].*"
    rb"|^(?= *(?:GRID|GRDSET)\*)[^,\n]{24}[ 0]{0,15}[1-9].*"
)
NEVER = {  # what makes or moves points and cells, and what brings them from another file
    "bdf": NASTRAN,
    "fem": NASTRAN,
    "inp": (
        rb"^[ \t]*\*(?:SYSTEM|NGEN|NFILL|NCOPY|NMAP|ELGEN|ELCOPY)\b.*"
        rb"|^[ \t]*\*NODE[ \t]*,.*\bSYSTEM[ \t]*=[ \t]*[CS].*"
        rb"|^[ \t]*\*(?:NODE|ELEMENT)[ \t]*,.*\bINPUT[ \t]*=.*"
        rb"|^[ \t]*\*INSTANCE\b.*\n[^*]*[1-9].*"
        rb"|^[ \t]*\*INCLUDE\b.*(?=(?s:.)*^[ \t]*\*NODE[ \t]*(?:,|\r|$))"
    ),
    "nas": NASTRAN,
}
KINDS = {*ONCE, *NEVER}
"""Suffixes of the files that are looked at."""


def passed_over(kind: str, data: bytes) -> str | None:
    r"""What a file of this kind holds that its reader would pass over, or None.

    Examples
    --------
    >>> passed_over("su2", b"NZONE= 2\nNPOIN= 4\nNPOIN= 6\n")
    '2 times NPOIN'
    >>> passed_over("nas", b"GRID,1,,0.,0.,1.\nGRID,2,5,1.,90.,0.\n")
    'GRID,2,5,1.,90.,0.'
    >>> passed_over("su2", b"NPOIN= 4\n") is None
    True
    """
    words = re.findall(ONCE[kind], data, re.I | re.M) if kind in ONCE else []
    counts = Counter(word.strip().decode("utf-8", "replace").upper() for word in words)
    for word, count in counts.items():
        if count > 1:
            return f"{count} times {word}"
    line = re.search(NEVER[kind], data, re.I | re.M) if kind in NEVER else None
    return None if line is None else " ".join(line[0].decode("utf-8", "replace").split())
