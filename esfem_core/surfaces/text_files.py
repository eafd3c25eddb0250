"""Files that are text: what trimesh reads differently from what their formats say."""

import re

__all__ = ["counted_from_the_first"]


def counted_from_the_first(data: bytes) -> bytes | None:
    r"""An OBJ file with corners that are numbers from 1 on, or None if it has no others.

    Negative numbers count back from the last vertex above their line, so that a part of a file
    does not depend on those before it; trimesh counts them from the end of the file. Of corners
    such as -3/-3/-3 the first number, the position, is kept.

    Examples
    --------
    >>> counted_from_the_first(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 1").splitlines()[3:]
    [b'f 1 2 3', b'v 0 0 1']
    >>> counted_from_the_first(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3") is None
    True
    """
    data = re.sub(rb"\\\r?\n", b"", data)
    if re.search(rb"^\s*f\s.*-", data, re.MULTILINE) is None:
        return None
    lines, count = [], 0
    for line in data.splitlines():
        words = line.split(b"#")[0].split()
        if words[:1] == [b"v"]:
            count += 1
        elif words[:1] == [b"f"]:
            corners = [int(word.split(b"/")[0]) for word in words[1:]]
            if min(corners, default=1) < -count:
                raise ValueError(f"a face has corner {min(corners)}, but {count} vertices above it")
            words[1:] = [b"%d" % (i if i > 0 else count + 1 + i) for i in corners]
        lines.append(b" ".join(words))
    return b"\n".join(lines)
