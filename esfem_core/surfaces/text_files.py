"""Files that are text: what trimesh reads differently from what their formats say."""

import codecs
import re

import numpy as np

from esfem_core.checks import Array, Ints

__all__ = ["check_ply", "counted_from_the_first", "points_and_polygons", "solids", "utf_8"]


def utf_8(data: bytes) -> bytes:
    r"""A text without the byte-order mark that programs of Windows put first, or data as it is.

    Examples
    --------
    >>> utf_8(b"\xef\xbb\xbfv 0 0 0"), utf_8("v 1 0 0".encode("utf-16"))
    (b'v 0 0 0', b'v 1 0 0')
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace").encode()
    return data.removeprefix(codecs.BOM_UTF8)


def counted_from_the_first(data: bytes) -> bytes | None:
    r"""An OBJ file with corners that are numbers from 1 on, or None if it is plain as it is.

    Negative numbers count back from the last vertex above their line, so that a part of a file
    does not depend on those before it; trimesh counts them from the end of the file. Of corners
    such as -3/-3/-3 the first number, the position, is kept. A corner 0, which trimesh takes for
    the first, is refused. Lines that are indented or have tabs, and a first one behind a byte-order
    mark, which it does not see, have their words between single blanks; comments behind them, and
    ends of lines as on old Macs, which it cannot read, are replaced.

    Examples
    --------
    >>> counted_from_the_first(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 1").splitlines()[3:]
    [b'f 1 2 3', b'v 0 0 1']
    >>> counted_from_the_first(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3") is None
    True
    """
    plain = utf_8(data)
    text = re.sub(rb"\\\n", b"", re.sub(rb"\r\n?", b"\n", plain))
    if re.search(rb"^ |\t|^v.*#|^f\s.*(#|-|(?<=\s)0+(?=[\s/]|$))", text, re.MULTILINE) is None:
        return text if plain != data or b"\r" in plain.replace(b"\r\n", b"") else None
    lines, count = [], 0
    for line in text.splitlines():
        words = line.split(b"#")[0].split()
        if words[:1] == [b"v"]:
            count += 1
        elif words[:1] == [b"f"]:
            corners = [int(word.split(b"/")[0]) for word in words[1:]]
            if 0 in corners:
                raise ValueError("a face has corner 0: corners of an OBJ file count from 1")
            if wrong := [i for i in corners if i < -count]:
                raise ValueError(f"a face has corner {wrong[0]}, but {count} vertices above it")
            words[1:] = [b"%d" % (i if i > 0 else count + 1 + i) for i in corners]
        lines.append(b" ".join(words))
    return b"\n".join(lines)


def points_and_polygons(text: str) -> tuple[Array, list[Ints]]:
    """Points and polygons, by their number of corners, of an OFF file.

    trimesh takes a file that was cut off for a surface with holes, and cannot read polygons of
    several kinds beside each other.

    Examples
    --------
    >>> text = "OFF 4 2 0  0 0 0  1 0 0  1 1 0  0 1 0  3 0 1 2  3 0 2 3"
    >>> points_and_polygons(text.replace("  ", chr(10)))[1]
    [array([[0, 1, 2],
           [0, 2, 3]])]
    """
    kind, word, rest = re.sub("#.*", "", text).partition("OFF")
    rows = [words for line in rest.splitlines() if (words := line.split())]
    if not word or not rows or len(rows[0]) < 2:
        raise ValueError("OFF and the numbers of points and polygons must come first")
    if re.search("[4n]", kind):
        raise ValueError(
            f"points must have three coordinates, but {kind.strip()}OFF stands for another number"
        )
    n, m = int(rows[0][0]), int(rows[0][1])
    points = [row[:3] for row in rows[1 : n + 1] if len(row) > 2]
    polygons: dict[int, list[list[str]]] = {}
    for row in rows[n + 1 : n + m + 1]:
        if len(row) > (k := int(row[0])):
            polygons.setdefault(k, []).append(row[1 : k + 1])
    count = sum(map(len, polygons.values()))
    if len(points) < n or count < m:
        raise ValueError(
            "it was cut off, or has not each point and polygon in a line of its own: of "
            f"{n} points it has {len(points)}, and of {m} polygons {count}"
        )
    cells = [np.array(polygons[k], dtype=np.int64) for k in sorted(polygons) if k > 2]
    return np.array(points, dtype=float).reshape(-1, 3), cells


def check_ply(data: bytes) -> None:
    r"""Refuse a PLY file of text that has other lines than its header counts.

    trimesh takes a file that was cut off for a surface with holes, and of lines that are too many
    the first ones.

    Examples
    --------
    >>> head = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n"
    >>> check_ply(head + b"0.5\n1.5\n")
    Traceback (most recent call last):
        ...
    ValueError: its header counts 3 lines of points and faces, but it has 2: it was cut off, or the
    header is wrong
    """
    head, end, body = data.partition(b"end_header")
    words = [line.split() for line in head.decode("utf-8", "replace").splitlines()]
    if not end or ["format", "ascii"] not in [line[:2] for line in words]:
        return  # in binary files trimesh looks at the numbers itself
    elements: list[tuple[int, list[str]]] = []
    for first, *rest in filter(None, words):
        if first == "element":
            elements.append((int(rest[1]), []))
        elif first == "property":
            elements[-1][1].append(rest[0])
    count = sum(n for n, _ in elements)
    lines = [line for line in body.splitlines() if line.strip()]
    if lines and len(lines) == count:
        last = [properties for n, properties in elements if n][-1]
        if not _is_whole(lines[-1].split(), last):
            lines.pop()
    if len(lines) != count:
        raise ValueError(
            f"its header counts {count} lines of points and faces, but it has {len(lines)}: it was "
            "cut off, or the header is wrong"
        )


def _is_whole(words: list[bytes], properties: list[str]) -> bool:
    """Whether a line has a number for each property; a list is its length and so many more."""
    n = 0
    for kind in properties:
        n += 1 + (int(float(words[n])) if kind == "list" and n < len(words) else 0)
    return n <= len(words)


def solids(data: bytes) -> list[Array] | None:
    r"""Corners of the triangles of each solid of an STL file, (T, 3, 3), or None if it is no text.

    Of several solids trimesh merges vertices within 1e-8, however small they are, and leaves out
    the last one if the file was cut off. A file that is no text and has another length than its
    number of triangles takes is refused: trimesh looks for text in it.

    Examples
    --------
    >>> facet = b"facet normal 0 0 1\n" + 3 * b"vertex 1 2 3e-9\n" + b"endfacet\n"
    >>> [len(solid) for solid in solids(2 * (b"solid a\n" + facet + b"endsolid a\n"))]
    [1, 1]
    """
    count = int.from_bytes(data[80:84], "little")
    if len(data) == (size := 84 + 50 * count):
        return None
    text = b"\n" + re.sub(rb"\r\n?", b"\n", utf_8(data)).lower()
    if b"\0" in text and b"vertex" not in text:
        raise ValueError(
            f"it was cut off, or has more behind its end: with the {count} triangles that its "
            f"header counts it should have {size} bytes, but it has {len(data)}"
        )
    *whole, rest = re.split(rb"\n[ \t]*endsolid\b.*", text)
    found: list[Array] = []
    for solid in [*whole, rest]:
        facets = re.sub(rb"\n[ \t]*solid\b.*", b"", solid)  # without its name
        corners = re.findall(rb"vertex[ \t]+([-+.\dni]\S*[ \t]+\S+[ \t]+\S+)", facets)
        count = len(re.findall(rb"\bfacet\b", facets))
        if len(corners) != 3 * count or (count and solid is rest):
            raise ValueError(
                f"it was cut off, or has other facets than triangles: solid {len(found)} has "
                f"{count} facets and {len(corners)} corners"
                f"{', and does not end' if solid is rest else ''}"
            )
        found.append(np.array(b" ".join(corners).split(), dtype=float).reshape(-1, 3, 3))
    return [corners for corners in found if len(corners)]
