"""Manuals that the source holds already, put into the pages while Sphinx reads them.

A plugin's manual is the docstring of its class; a command's is what `--help` prints; that of a public module has the
docstrings of the names in its `__all__`.
"""

import ast
import importlib
import inspect
import re
import textwrap
from pathlib import Path
from types import ModuleType

import click

from phong_bsdf.cli import main

PLUGINS = Path(__file__).parent.parent / "phong_bsdf/plugins"
CLI = Path(__file__).parent.parent / "phong_bsdf/cli"

# In a page, these ask for the manual of a plugin, of a public module, and for those of all commands.
MODULE = re.compile(r"^<!-- manual of (phong_bsdf\.[\w.]+) -->$", re.M)
PLUGIN = re.compile(r"^<!-- manual of (\w+) -->$", re.M)
COMMANDS = re.compile(r"^<!-- manuals of the commands -->$", re.M)

EXAMPLES = {"XML::": "xml", "Python::": "python"}


def insert(app, docname, source):
    """For Sphinx, when it reads a page: marks become manuals, and the page is read again when those change."""
    text = source[0]
    if COMMANDS.search(text):
        for path in CLI.glob("*.py"):
            app.env.note_dependency(path)
    for plugin in PLUGIN.findall(text):
        app.env.note_dependency(PLUGINS / f"{plugin}.py")
    for module in MODULE.findall(text):
        for path in sources(importlib.import_module(module)):
            app.env.note_dependency(path)
    text = MODULE.sub(lambda mark: names(importlib.import_module(mark[1])), text)
    text = PLUGIN.sub(lambda mark: f"```{{eval-rst}}\n{restructured(manual(mark[1]))}\n```", text)
    source[0] = COMMANDS.sub(lambda _: commands(), text)


def manual(plugin: str) -> str:
    """The docstring of the class in `plugins/PLUGIN.py`. It is not imported: it would be a class of one variant."""
    module = ast.parse((PLUGINS / f"{plugin}.py").read_text(encoding="utf-8"))
    (found,) = (node for node in module.body if isinstance(node, ast.ClassDef))
    return ast.get_docstring(found)


def restructured(text: str) -> str:
    """reStructuredText: names become code, formulas stay as they are typed, examples get their colours."""
    paragraphs = [".. default-role:: code"]
    for paragraph in text.split("\n\n"):
        language = EXAMPLES.get(paragraphs[-1])
        if language:
            paragraphs[-1] = paragraphs[-1].removesuffix(":")
            paragraphs.append(f".. code-block:: {language}\n\n{paragraph}")
        elif paragraph.startswith("    "):
            paragraphs.append(f"::\n\n{paragraph}")
        else:
            paragraphs.append(paragraph)
    return "\n\n".join([*paragraphs, ".. default-role::"])


def commands() -> str:
    """Markdown: a heading for each command, and below it what its `--help` prints."""
    context = click.Context(main, info_name="phong-bsdf", **main.context_settings)
    return "\n\n".join(
        f"## {name}\n\n```text\n{usage(command, click.Context(command, context, name))}```"
        for name, command in main.commands.items()
    )


def usage(command: click.Command, context: click.Context) -> str:
    """What `--help` prints, at a width that fits into a page."""
    formatter = click.HelpFormatter(width=92)
    command.format_help(context, formatter)
    return formatter.getvalue()


def sources(module: ModuleType) -> set[Path]:
    """The files that the public names of a module are written in."""
    written = [inspect.getmodule(getattr(module, name)) or module for name in module.__all__]
    return {Path(found.__file__) for found in written}


def names(module: ModuleType) -> str:
    """Markdown: a heading for each public name of a module, functions first, and below it what it is."""
    ordered = sorted(module.__all__, key=lambda name: not inspect.isfunction(getattr(module, name)))
    return "\n\n".join(f"### {name}\n\n{described(module, name)}" for name in ordered)


def described(module: ModuleType, name: str) -> str:
    """Markdown of one name: how it is called, its docstring, and what a class has."""
    value = getattr(module, name)
    if inspect.isfunction(value):
        return called(*parsed(value))
    if not inspect.isclass(value):
        return constant(module, name)
    node, source = parsed(value)
    parts = [code(f"class {node.name}" + "".join(f"({ast.unparse(base)})" for base in node.bases)), docstring(node)]
    parts.append("\n".join(f"- `{ast.unparse(field)}`{': ' * bool(text)}{text}" for field, text in fields(node.body)))
    parts += [called(method, source) for method in methods(node)]
    return "\n\n".join(part for part in parts if part)


def parsed(value) -> tuple[ast.FunctionDef | ast.ClassDef, str]:
    """The node of a function or class, and the source that its lines are counted in."""
    source = textwrap.dedent(inspect.getsource(value))
    return ast.parse(source).body[0], source


def called(node: ast.FunctionDef, source: str) -> str:
    """Markdown: a function's first lines, as they are written, and its docstring."""
    first = "\n".join(source.splitlines()[node.lineno - 1 : node.body[0].lineno - 1])
    first = textwrap.dedent(first).replace("  # fmt: skip", "").removesuffix(":")
    marks = "".join(f"@{ast.unparse(mark)}\n" for mark in node.decorator_list)
    return f"{code(marks + first)}\n\n{docstring(node)}".rstrip()


def methods(node: ast.ClassDef) -> list[ast.FunctionDef]:
    """The constructor and the public methods of a class."""
    found = [part for part in node.body if isinstance(part, ast.FunctionDef)]
    return [method for method in found if method.name == "__init__" or not method.name.startswith("_")]


def fields(body: list[ast.stmt]) -> list[tuple[ast.AnnAssign, str]]:
    """The public fields of a class, each with the string below it, or an empty one."""
    texts = [text_of(below) for below in [*body[1:], ast.Pass()]]
    both = zip(body, texts, strict=True)
    return [(field, text) for field, text in both if isinstance(field, ast.AnnAssign) and field.target.id[0] != "_"]


def constant(module: ModuleType, name: str) -> str:
    """Markdown: a constant with its value, and the string below it."""
    body = ast.parse(inspect.getsource(module)).body
    place = next(i for i, node in enumerate(body) if isinstance(node, ast.Assign) and node.targets[0].id == name)
    return f"{code(ast.unparse(body[place]))}\n\n{text_of(body[place + 1])}"


def text_of(node: ast.stmt) -> str:
    """What a string that is a statement says; of others nothing."""
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    return inspect.cleandoc(node.value.value) if is_text else ""


def docstring(node) -> str:
    return ast.get_docstring(node) or ""


def code(text: str) -> str:
    return f"```python\n{text}\n```"
