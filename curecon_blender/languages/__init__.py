# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's words in Blender's language: one file a language, and what core and the worker said in English."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.base.language import Language, load

CONTEXT = "CU-Recon"  # for words that Blender has for other things, such as Surface
CONTEXTS = ("*", "Operator", CONTEXT)  # Blender looks buttons up in the second

_languages: dict[str, Language] = {}


def start() -> None:
    _languages.update(load())
    bpy.app.translations.register(__name__, {
        name: {(context, text): words for text, words in language.words.items() for context in CONTEXTS}
        for name, language in _languages.items()
    })


def stop() -> None:
    bpy.app.translations.unregister(__name__)
    _languages.clear()


def current() -> str:
    """Blender's language by its name, such as zh_HANS, where this add-on speaks it and it is on; else empty."""
    name = bpy.app.translations.locale
    return name if name in _languages and bpy.context.preferences.view.use_translate_interface else ""


def translated(text: str) -> str:
    """A text in Blender's language that was put together in English, such as an error of core or a note of the frame.
    What has no translation stays, as do the names, paths and numbers within."""
    language = _languages.get(current())
    return iface_(text) if language is None else language.translated(text)
