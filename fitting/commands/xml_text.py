"""Texts and names of files in XML."""

import hashlib
import os
import re

from ...merl_io.source import PLAIN


def word(name: str) -> str:
    """Name of a file that XML names: Mitsuba takes ``$`` for a parameter of the scene, and XML has no control codes.

    A name that is changed for that is no other's.
    """
    plain = re.sub(r"[$\x00-\x1f\x7f-\x9f]", "_", name)
    return plain if plain == name else f"{plain}-{hashlib.sha1(os.fsencode(name)).hexdigest()[:8]}"


def comment(text: str) -> str:
    """What XML allows in a comment."""
    return re.sub("-{2,}", "-", text.translate(PLAIN)).replace("<", " ").replace("&", "and")
