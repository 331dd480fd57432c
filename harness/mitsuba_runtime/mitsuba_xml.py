"""A Mitsuba XML file as Mitsuba reads it: what is in it, and what determines it.

Mitsuba's own parser expands ``<default>``, ``<include>``, ``<path>``, ``$parameters`` and
spectra in files, and turns the names of older versions into today's. Its result, a list of
nodes, each a plugin with its properties, is what is looked into, hashed and edited. That takes
no variant of Mitsuba.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from harness.core.protocol.errors import InputError, nearest
from harness.mitsuba_runtime import python_plugins, search_path

Resolve = Callable[[str], Path]
_PARAMETERS = re.compile(r"""\$(\w+)|<default[^>]*\bname=["'](\w+)""")


@dataclass(frozen=True)
class MitsubaFile:
    """A file that was read; ``state`` is Mitsuba's own (``mitsuba.parser.ParserState``).

    Names of files in it are absolute. ``files`` are all that were read or are named, each once,
    the file itself first; ``parsed`` are the XML files among them.
    """

    path: Path
    where: str
    state: Any
    files: tuple[Path, ...]
    parsed: tuple[Path, ...]

    @property
    def root(self) -> str:
        """Kind of the root, ``"Scene"`` or another."""
        return self.state.nodes[0].type.name

    def nodes(self, kind: str) -> list[tuple[int, Any]]:
        """``(index, node)`` of every node of a kind, such as ``"BSDF"``, in the file's order."""
        return nodes(self.state, kind)

    def ids(self, kind: str) -> list[str]:
        """The ids of nodes of a kind, in the file's order."""
        return [node.props.id() for _, node in self.nodes(kind) if node.props.id()]

    def editable(self) -> Any:
        """A copy of the state, in which every reference is an index; for :func:`instantiate`."""
        import mitsuba as mi

        state = mi.parser.ParserState(self.state)
        mi.parser.transform_resolve(_config(), state)
        return state

    def content_hash(self) -> str:
        """SHA-256 of what the file says, with the contents of other files in place of names."""
        import mitsuba as mi

        state = self.editable()
        for node in state.nodes:
            for key, value in _strings(node):
                if Path(value).is_absolute() and Path(value) in self.files:
                    node.props[key] = file_hash(Path(value), self.where)
            if python_plugins.is_own(node.props.plugin_name()):
                node.props.set_plugin_name(python_plugins.identity(node.props.plugin_name()))
        # Written out, numbers have all their digits; ids that nothing refers to are left out.
        text = json.dumps([mi.parser.write_string(state), [n.props.id() for n in state.nodes]])
        return hashlib.sha256(text.encode()).hexdigest()


def nodes(state: Any, kind: str) -> list[tuple[int, Any]]:
    """``(index, node)`` of every node of a kind, such as ``"BSDF"``, in the file's order."""
    return [(i, node) for i, node in enumerate(state.nodes) if node.type.name == kind]


def references(node: Any) -> list[tuple[str, int]]:
    """``(property, index)`` of the nodes that a node of an editable state has as children."""
    return [(key, node.props[key].index()) for key in _keys(node, "ResolvedReference")]


def add(state: Any, kind: str, plugin: str, **properties: Any) -> int:
    """Append a node to an editable state; its index. A child is ``ResolvedReference(index)``.

    Nodes that were taken from the state before are of no use after that.
    """
    import mitsuba as mi

    node, props = mi.parser.SceneNode(), mi.Properties()
    props.set_plugin_name(plugin)
    for key, value in properties.items():
        props[key] = value
    node.type, node.props = getattr(mi.ObjectType, kind), props
    state.nodes.append(node)
    return len(state.nodes) - 1


def used(path: Path, where: str, parameters: Mapping[str, Any]) -> list[str]:
    """Names of those ``parameters`` that the file, or one that it includes, has."""
    file = read(path, where, parameters, strict=False)
    texts = [f.read_text(encoding="utf-8", errors="replace") for f in file.parsed]
    names = {name for text in texts for pair in _PARAMETERS.findall(text) for name in pair}
    return [name for name in parameters if name in names]


def read(
    path: Path, where: str, parameters: Mapping[str, Any] | None = None, strict: bool = True
) -> MitsubaFile:
    """The file at ``path`` with ``parameters`` in place of its ``$names``.

    ``strict``: to refuse parameters that the file does not have.

    Raises:
        InputError: no such file, nothing that Mitsuba's parser takes, a parameter that the file
            does not have, or a file that it names is missing. ``where`` names what the file was
            given for.
    """
    import mitsuba as mi

    _check_readable(path, where)
    given = _texts(parameters or {}, where)
    path = path.resolve()
    config = _config()
    if not strict:
        config.unused_parameters = mi.LogLevel.Debug
    with search_path.beginning_with(path.parent) as resolver:

        def resolve(name: str) -> Path:
            return Path(str(resolver.resolve(name)))

        try:
            state = mi.parser.parse_file(config, str(path), **given)
            mi.parser.transform_upgrade(config, state)
            mi.parser.transform_resolve(config, mi.parser.ParserState(state))
        except RuntimeError as error:
            raise InputError(f"{where}: {path}: {_reason(str(error), path)}") from None
        parsed = [Path(str(file)).resolve() for file in state.files]
        files = [*parsed, *_spectra(parsed, given, resolve)]
        files += _make_absolute(state, resolve, path, where)
    return MitsubaFile(path, where, state, tuple(dict.fromkeys(files)), tuple(parsed))


def instantiate(state: Any, folder: Path, where: str) -> Any:
    """Mitsuba's object of an edited state; the variant must be set.

    Raises:
        InputError: Mitsuba cannot load it.
    """
    import mitsuba as mi

    config = _config()
    config.variant = mi.variant()
    for _, node in enumerate(state.nodes):
        if python_plugins.is_own(node.props.plugin_name()):
            node.props.set_plugin_name(python_plugins.register(node.props.plugin_name(), where))
    # Plugins that look for files by themselves find them in the file's own folder.
    with search_path.beginning_with(folder):
        try:
            mi.parser.transform_all(config, state)
            made = mi.parser.instantiate(config, state)
        except RuntimeError as error:
            raise InputError(f"{where}: Mitsuba cannot load it: {said(str(error))}") from None
    return made[0] if isinstance(made, list) else made


def file_hash(path: Path, where: str) -> str:
    """SHA-256 of a file's bytes; an :class:`InputError` if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise InputError(f"{where}: no such file: {path}") from None
    except OSError as error:
        raise InputError(f"{where}: {path} cannot be read: {error.strerror}") from None


# --- helpers ---------------------------------------------------------------------------


def _config() -> Any:
    import mitsuba as mi

    # Parsing is the same in every variant.
    return mi.parser.ParserConfig("llvm_ad_rgb")


def _check_readable(path: Path, where: str) -> None:
    if not path.is_file():
        raise InputError(f"{where}: no such file: {path}")
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except OSError as error:
        raise InputError(f"{where}: {path} cannot be read: {error.strerror}") from None
    except ElementTree.ParseError as error:
        raise InputError(f"{where}: {path} is not XML: {error}") from None
    if root.get("version") is None:
        raise InputError(
            f"{where}: {path} is no Mitsuba file: its root <{root.tag}> has no version"
        )


def _texts(parameters: Any, where: str) -> dict[str, str]:
    """Parameters as Mitsuba's parser takes them."""
    if not isinstance(parameters, Mapping):
        raise InputError(f"{where}: parameters: expected a mapping, got {parameters!r}")
    found = {}
    for key, value in parameters.items():
        if not isinstance(key, str) or not isinstance(value, str | int | float):
            said = f"expected a number or a text, got {value!r}"
            raise InputError(f"{where}: parameters: {key}: {said}")
        found[key] = str(value).lower() if isinstance(value, bool) else str(value)
    return found


def _keys(node: Any, kind: str) -> list[str]:
    """The properties of a node that are of a kind."""
    names = node.props.keys()
    return [name for name in names if node.props.type(name).name == kind]


def _strings(node: Any) -> list[tuple[str, str]]:
    """The properties of a node that are texts."""
    return [(key, node.props[key]) for key in _keys(node, "String")]


def _make_absolute(state: Any, resolve: Resolve, path: Path, where: str) -> list[Path]:
    """Give every file that the nodes name its whole name; which they are."""
    found = []
    where = f"{where}: {path.name}"
    for node in state.nodes:
        plugin = node.props.plugin_name()
        if python_plugins.is_own(plugin):
            file, _, name = plugin.rpartition(":")
            node.props.set_plugin_name(f"{resolve(file).resolve()}:{name}")
            python_plugins.check(node.props.plugin_name(), where)
            found.append(python_plugins.file_of(node.props.plugin_name()))
        for key, value in _strings(node):
            file = resolve(value) if value else Path()
            # Others than "filename" may name a file, such as one of a plugin of the user's own.
            if file.is_file() and (key == "filename" or "." in value):
                found.append(file.resolve())
                node.props[key] = str(found[-1])
            elif key == "filename":
                beside = [f.name for f in (path.parent / value).parent.glob(f"*{file.suffix}")]
                hint = nearest(file.name, beside) if beside else ""
                raise InputError(f"{where}: no such file: {value}{hint}")
    return found


def _spectra(parsed: list[Path], given: Mapping[str, str], resolve: Resolve) -> list[Path]:
    """Files of spectra, which the parser has read, so that its nodes hold the numbers alone."""
    roots = [ElementTree.parse(path).getroot() for path in parsed]
    values: dict[str, str] = dict(given)
    for root in roots:
        for item in root.iter("default"):
            values.setdefault(item.get("name", ""), item.get("value", ""))
    names = [e.get("filename") for root in roots for e in root.iter("spectrum")]
    return [resolve(_expanded(name, values)).resolve() for name in names if name]


def _expanded(text: str, values: Mapping[str, str]) -> str:
    # The longest name first, as one may begin another.
    for name in sorted(values, key=len, reverse=True):
        text = text.replace(f"${name}", values[name])
    return text


def _reason(message: str, path: Path) -> str:
    unused = re.search(r"unused parameters:\s*- \$(\w+)", message)
    if unused:
        text = path.read_text(encoding="utf-8", errors="replace")
        known = {name for pair in _PARAMETERS.findall(text) for name in pair if name}
        hint = nearest(unused[1], known) if known else "; the file has no parameters"
        return f"parameters: it has no '${unused[1]}'{hint}"
    return said(message)


def said(message: str) -> str:
    """Mitsuba's message in one line, without the places in its source."""
    text = re.sub(r"\[\w+\.(cpp|h):\d+\] ?", "", " ".join(message.split()))
    parts = text.split("while processing <include>: ")
    return parts[0] + (f"... {parts[-1]}" if len(parts) > 2 else "".join(parts[1:]))
