"""What a file of measured or learnt reflectance is, told by how it begins: for refusals."""

from __future__ import annotations

import struct
from pathlib import Path

_STARTS = (
    (b"tensor_file\0", "a measured BSDF of the RGL database: expected 'type: measured'"),
    (b"!DFMF", "a BTF of the University of Bonn: expected 'type: btf'"),
    (b"!FMF", "a BTF of the University of Bonn: expected 'type: btf'"),
    (b"!PVF", "a BTF of the University of Bonn in vertex factors, which cannot be read"),
    (b"!BDI", "a raw BTF of the University of Bonn, which cannot be read"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file (as Keras writes): expected 'type: nbrdf' and a name that"
     " ends in .h5 if it is a network of Sztrajman et al."),
    (b"\x93NUMPY", "an array of numpy: expected 'type: nbrdf' if it is one of Sztrajman et al."),
    (b"PK\x03\x04", "an archive (as torch.save or numpy.savez write): expected 'type: neural' if"
     " it is a checkpoint of NeuMIP"),
    (b"\x76\x2f\x31\x01", "a picture in OpenEXR: expected a bitmap texture, or an environment"),
    (b"#?RADIANCE", "a picture in Radiance's HDR: expected a bitmap texture, or an environment"),
    (b"\x89PNG", "a picture: expected a bitmap texture"),
    (b"\xff\xd8\xff", "a picture: expected a bitmap texture"),
)  # fmt: skip
_UTIA_BYTES = 3 * 8 * 288**2


def said_of(path: Path) -> str:
    """What the file is and how to name it, in words that follow "it is"; "" if not known."""
    try:
        with path.open("rb") as file:
            head = file.read(16)
        size = path.stat().st_size
    except OSError:
        return ""
    for start, said in _STARTS:
        if head.startswith(start):
            return said
    if len(head) >= 12 and struct.unpack("<3i", head[:12]) == (90, 90, 180):
        return "a table of the MERL database: expected 'type: merl'"
    if size == _UTIA_BYTES:
        return "a table of the UTIA database, by its size: expected 'type: utia'"
    return ""
