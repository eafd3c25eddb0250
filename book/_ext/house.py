"""Sphinx extension: the plan of the package, drawn from its sources.

Four directives, in reStructuredText since docstrings are, show what a room hands out, which rooms
there are, what to read in which order, and where the code names a place of the papers. Every object
is documented once, under the module that defines it; a reference by any other name that hands it
out, such as ``esfem_core.evolve``, finds it there.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, ClassVar

import sources
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from ledger import cells, table
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode


class SourceLink(nodes.General, nodes.Element):
    """Stands for a link to the listing of a module; anchors are known when all is read."""


class HouseDirective(SphinxDirective):
    """Common parts of the directives."""

    def read(self, module: str) -> None:
        """Note that the page depends on a module."""
        self.env.note_dependency(str(sources.path_of(module)))

    def first_line(self, name: str) -> nodes.container:
        """Parse the first line of a docstring."""
        node, context = nodes.container(), self.env.ref_context
        outer = context.get("py:module")
        context["py:module"] = sources.split(name)[0]
        line = StringList([sources.first_line(name)], source=name)
        self.state.nested_parse(line, 0, node)
        context["py:module"] = outer
        return node

    def documented(self, name: str, shown: str) -> nodes.paragraph:
        """Link to the documentation of an object, or of its module where it has none of its own."""
        link = pending_xref(
            "", nodes.literal("", shown), refdomain="py", reftype="obj", reftarget=name
        )
        link["refdoc"], link["or_module"] = self.env.docname, sources.split(name)[0]
        return nodes.paragraph("", "", link)


class HandedOut(HouseDirective):
    """List what a room, or the package, hands out in ``__all__``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Set a table of names and first lines."""
        module = self.arguments[0]
        self.read(module)
        rows = []
        for name in sources.handed_out(module):
            home = sources.home(f"{module}.{name}")
            self.read(sources.split(home)[0])
            rows.append(cells(self.documented(home, name), self.first_line(home)))
        return [table(["name", "what it is"], rows, "esfem-house")]


class House(HouseDirective):
    """List the rooms, given in their order, and which of them each imports from."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Set a table of the rooms and a matrix of their imports."""
        rooms = " ".join(self.content).split()
        plan, matrix = [], []
        for number, room in enumerate(rooms, start=1):
            inside = sources.modules(f"{sources.PACKAGE}.{room}")
            for module in inside:
                self.read(module)
            before = {m.split(".")[1] for i in inside for _, m, _ in sources.imports(i) if "." in m}
            total = sum_lines(inside)
            link = self.documented(inside[0], room)
            plan.append(
                cells(
                    nodes.paragraph("", str(number)),
                    link,
                    self.first_line(inside[0]),
                    nodes.paragraph("", f"{total.all:,}"),
                )
            )
            marks = ("■" if r == room else "●" if r in before else "" for r in rooms)
            matrix.append(
                cells(
                    nodes.paragraph("", f"{number} {room}"),
                    *(nodes.paragraph("", mark) for mark in marks),
                )
            )
        numbers = [str(n + 1) for n in range(len(rooms))]
        return [
            table(["", "room", "what it is", "lines"], plan, "esfem-house"),
            table(["imports from", *numbers], matrix, "esfem-imports"),
        ]


class ReadingPath(HouseDirective):
    """List modules in the order in which to read them: a definition list, module and reason."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Set a table with the places of the papers that each module names, and its length."""
        content = nodes.container()
        self.state.nested_parse(self.content, self.content_offset, content)
        rows, modules = [], []
        for item in content.findall(nodes.definition_list_item):
            module = item.children[0].astext()
            modules.append(module)
            self.read(module)
            count = sources.lines(module)
            rows.append(
                cells(
                    self.documented(module, module.partition(".")[2]),
                    nodes.container("", *item.children[-1].children),
                    nodes.paragraph("", equations(module)),
                    nodes.paragraph("", f"{count.all}"),
                    nodes.paragraph("", f"{count.code}"),
                )
            )
        total = sum_lines(modules)
        rows.append(
            cells(
                *(nodes.paragraph("", text) for text in ("together", "", "")),
                *(nodes.paragraph("", f"{n:,}") for n in total),
            )
        )
        titles = ["module", "read it for", "equations", "lines", "code"]
        return [table(titles, rows, "esfem-house")]


class EquationIndex(HouseDirective):
    """List each place of a paper that the sources name, and who names it."""

    option_spec: ClassVar = {
        "paper": directives.unchanged_required,
        "equations": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """Set a table; with ``equations`` of numbered equations only, else of all other places."""
        found: dict[sources.Place, list[tuple[str, str]]] = {}
        # The book's own machinery last.
        modules = sources.modules(sources.PACKAGE)
        for module in sorted(modules, key=lambda m: m.startswith(f"{sources.PACKAGE}.companion")):
            self.read(module)
            for place, names in sources.cited(module).items():
                found.setdefault(place, []).extend((module, name) for name in names)
        rows = []
        for place in sorted(found, key=sources.sort_key):
            if place.paper == self.options["paper"] and (
                (place.kind == "") == ("equations" in self.options)
            ):
                label = str(place).removeprefix(f"{place.paper} ")
                rows.append(cells(nodes.paragraph("", label), self.named(found[place])))
        return [table(["place", "in the code"], rows, "esfem-house")]

    def named(self, by: Iterable[tuple[str, str]]) -> nodes.bullet_list:
        """Return links to the listings, each with the first line of what is there."""
        items = []
        for module, name in by:
            line = nodes.paragraph("", "", SourceLink(module=module, name=name), nodes.Text(" "))
            for says in self.first_line(f"{module}.{name}" if name else module):
                line += says.children
            items.append(nodes.list_item("", line))
        return nodes.bullet_list("", *items)


def equations(module: str) -> str:
    """Return the equations that a module names: ``[N] (2.18), (2.22); [LMV] (3.2)``."""
    numbers: dict[str, list[str]] = {}
    for place in sources.cited(module):
        if not place.kind:
            numbers.setdefault(place.paper, []).append(str(place).removeprefix(place.paper))
    return "; ".join(f"{paper}{','.join(found)}" for paper, found in numbers.items())


def sum_lines(modules: Iterable[str]) -> sources.Lines:
    """Add up the lines of modules."""
    total = sources.Lines(0, 0)
    for module in modules:
        total += sources.lines(module)
    return total


def anchor(app: Sphinx, module: str, name: str) -> str:
    """Return where a definition begins in the listing of its module.

    viewcode makes anchors for what is documented; :func:`add_anchors` makes the others.
    """
    documented = f"{module}.{name}" in app.env.domains["py"].objects
    return name if documented or not name else f"def-{name.rpartition('.')[2]}"


def link_sources(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Put links where the directives left places for them."""
    for place in list(doctree.findall(SourceLink)):
        module, name = place["module"], place["name"]
        short = module.partition(".")[2] or module
        shown = nodes.literal("", f"{short}.{name}" if name else short)
        page = app.builder.get_relative_uri(docname, f"_modules/{module.replace('.', '/')}")
        uri = f"{page}#{anchor(app, module, name)}".removesuffix("#")
        place.replace_self(nodes.reference("", "", shown, internal=True, refuri=uri))


def add_anchors(
    app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object
) -> None:
    """Give every function and class of a listing an anchor."""
    if not page.startswith(f"_modules/{sources.PACKAGE}"):
        return
    seen: set[str] = set()

    def named(match: re.Match[str]) -> str:
        if match[2] in seen:
            return match[0]
        seen.add(match[2])
        return f'<span class="{match[1]}" id="def-{match[2]}">{match[2]}</span>'

    context["body"] = re.sub(r'<span class="(n[fc])">(\w+)</span>', named, context["body"])


def resolve(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, shown: nodes.Element
) -> nodes.reference | None:
    """Find what a reference means that uses another name than that of the definition.

    A docstring may use the names of its module and of its room without their paths.
    """
    if node.get("refdomain") != "py":
        return None
    target, module = node["reftarget"], node.get("py:module") or ""
    objects = env.domains["py"].objects
    room = ".".join(module.split(".")[:2])
    for name in (f"{module}.{target}", f"{room}.{target}", target, node.get("or_module", "")):
        home = sources.home(name)
        if home in objects:
            entry = objects[home]
            return make_refnode(
                app.builder, node["refdoc"], entry.docname, entry.node_id, [shown], home
            )
    return None


def skip_fields(
    app: Sphinx, what: str, name: str, member: object, skip: bool, options: object
) -> bool | None:
    """Leave out the fields of named tuples: their class documents them as attributes."""
    return True if type(member).__name__ == "_tuplegetter" else None


def setup(app: Sphinx) -> dict[str, object]:
    """Register the directives."""
    app.add_node(SourceLink)
    app.add_directive("handed-out", HandedOut)
    app.add_directive("house", House)
    app.add_directive("reading-path", ReadingPath)
    app.add_directive("equation-index", EquationIndex)
    app.connect("autodoc-skip-member", skip_fields)
    app.connect("missing-reference", resolve)
    app.connect("doctree-resolved", link_sources)
    app.connect("html-page-context", add_anchors)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
