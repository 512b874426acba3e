"""Files of points built byte by byte: .npy, .npz and .pcd."""

import io

import numpy as np

ROWS = np.array([[1.0, 2.0, 3.0, 40.0, 5.0], [-1.0, 0.5, 0.25, 255.0, 127.0]], np.float32)


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def npy(array, version=None):
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, version)
    return buffer.getvalue()


def pcd(kind, body, layout=("x y z intensity ring", "4 4 4 4 2", "F F F F U", "1 1 1 1 1"), points=2):
    """A .pcd file; ``layout`` is what its header says of the fields: names, sizes, types, counts."""
    fields, size, types, count = layout
    header = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {types}\nCOUNT {count}\n"
        f"WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {kind}\n"
    )
    return header.encode() + body


def lzf_literals(raw):
    return b"".join(bytes([len(raw[i : i + 32]) - 1]) + raw[i : i + 32] for i in range(0, len(raw), 32))


def text(rows=ROWS):
    return "\n".join(" ".join(f"{v:g}" for v in row) for row in rows).encode()
