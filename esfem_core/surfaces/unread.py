"""What files may hold that trimesh and meshio pass over, so that the surface is another one.

Of parts some are lost or stand in wrong places, and nothing tells of it: such files are refused.
"""

import json
import re
from collections import Counter
from importlib.util import find_spec
from typing import Any

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
KINDS = {*ONCE, *NEVER, "glb", "gltf"}
"""Suffixes of the files that are looked at."""

DRACO = "KHR_draco_mesh_compression"


def passed_over(kind: str, data: bytes) -> str | None:
    r"""What a file of this kind holds that its reader would pass over, or None.

    Raises
    ------
    ImportError
        If a package that reads it is missing, and zeros would be read without it.

    Examples
    --------
    >>> passed_over("su2", b"NZONE= 2\nNPOIN= 4\nNPOIN= 6\n")
    '2 times NPOIN'
    >>> passed_over("nas", b"GRID,1,,0.,0.,1.\nGRID,2,5,1.,90.,0.\n")
    'GRID,2,5,1.,90.,0.'
    >>> passed_over("su2", b"NPOIN= 4\n") is None
    True
    """
    if kind in ("glb", "gltf"):
        return _of_gltf(kind, data)
    words = re.findall(ONCE[kind], data, re.I | re.M) if kind in ONCE else []
    counts = Counter(word.strip().decode("utf-8", "replace").upper() for word in words)
    for word, count in counts.items():
        if count > 1:
            return f"{count} times {word}"
    line = re.search(NEVER[kind], data, re.I | re.M) if kind in NEVER else None
    return None if line is None else " ".join(line[0].decode("utf-8", "replace").split())


def _of_gltf(kind: str, data: bytes) -> str | None:
    """The same for glTF, by its JSON; what is wrong with that, its reader says."""
    binary = data.startswith(b"glTF")
    text = data[20 : 20 + int.from_bytes(data[12:16], "little")] if binary else data
    try:
        tree = json.loads(text)
        required = tree.get("extensionsRequired", [])
        found = [name for name in required if "compression" in name and name != DRACO]
        found += {"EXT_mesh_gpu_instancing"} & set(tree.get("extensionsUsed", []))
        found += [what for mesh in tree.get("meshes", []) for what in _of_mesh(tree, mesh)]
    except (ValueError, LookupError, TypeError, AttributeError):
        return None
    if DRACO in required and find_spec("DracoPy") is None:
        raise ImportError(
            f"files .{kind} compressed with Draco need another package: pip install DracoPy",
            name="DracoPy",
        )
    return next(iter(found), None)


def _of_mesh(tree: dict[str, Any], mesh: dict[str, Any]) -> list[str]:
    """The same for one mesh of glTF: kinds of triangles, positions and corners."""
    found = []
    for part in mesh["primitives"]:
        mode = part.get("mode", 4)
        if mode == 6:
            found.append("triangle fans (mode 6)")
        if mode in (4, 5):  # of lines and points nothing is taken
            positions = tree["accessors"][part["attributes"]["POSITION"]]
            corners = tree["accessors"][part["indices"]] if "indices" in part else {}
            if "sparse" in positions or "sparse" in corners:
                found.append("a sparse accessor")
            if positions.get("normalized"):
                found.append("normalized positions")
    return found
