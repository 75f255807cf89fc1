"""The shape of the source tree: layers, no cycles, docstrings, nothing private crossing a file's border."""

from __future__ import annotations

import ast
import gc
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "sightline"

# Each layer may import only itself and those before it.
LAYERS = (
    "version errors inputs result access execution compiled writing output stages geometry estimation "
    "imaging matching photogrammetry motion products tdi simulate applications evaluation io report kinds "
    "cli __main__"
).split()

# (who, what it never imports)
BANS = [("applications", "sightline.simulate"), ("matching", "sightline.geometry.camera")]


def module_name(path: Path) -> str:
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_name(path): path for path in sorted(SOURCE.rglob("*.py"))}
MODULES = sorted(set(FILES) - {"sightline"})


@cache
def tree_of(module: str) -> ast.Module:
    return ast.parse(FILES[module].read_text(encoding="utf-8"))


@pytest.fixture(scope="module", autouse=True)
def trees_kept_for_this_file_alone() -> Iterator[None]:
    """Trees are millions of objects without a cycle: to look for some takes longer than to parse."""
    gc.disable()
    yield
    gc.enable()
    for kept in (tree_of, nodes, imports):
        kept.cache_clear()


@cache
def nodes(module: str) -> tuple[ast.AST, ...]:
    """The statements and expressions that any rule is about."""
    kinds = ast.Import | ast.ImportFrom | ast.Assert | ast.If
    return tuple(node for node in ast.walk(tree_of(module)) if isinstance(node, kinds))


def layer(module: str) -> str:
    return module.split(".")[1]


@cache
def imports(module: str) -> tuple[tuple[str, str, int], ...]:
    """Every import of our own modules, wherever it stands: (module, name or "", line)."""
    return tuple(_imports(module))


def _imports(module: str) -> Iterator[tuple[str, str, int]]:
    package = module if FILES[module].name == "__init__.py" else module.rpartition(".")[0]
    for node in nodes(module):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "sightline":
                    yield alias.name, "", node.lineno
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")
                base = ".".join([*parents[: len(parents) - node.level + 1], *filter(None, [base])])
            if base.split(".")[0] == "sightline":
                for alias in node.names:
                    inner = f"{base}.{alias.name}"
                    yield (inner, "", node.lineno) if inner in FILES else (base, alias.name, node.lineno)


def public_definitions(tree: ast.Module) -> Iterator[tuple[str, ast.AST]]:
    """Public classes, functions, methods and properties, with their dotted names."""
    for node in tree.body:
        if not isinstance(node, ast.ClassDef | ast.FunctionDef) or node.name.startswith("_"):
            continue
        yield node.name, node
        if isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, ast.FunctionDef) and not inner.name.startswith("_"):
                    yield f"{node.name}.{inner.name}", inner


def test_every_file_belongs_to_a_layer():
    assert {layer(module) for module in MODULES} <= set(LAYERS)


def test_a_module_imports_only_its_own_layer_and_earlier_ones():
    late = [
        f"{module}, line {line}: {target}"
        for module in MODULES
        for target, _, line in imports(module)
        if target != "sightline" and LAYERS.index(layer(target)) > LAYERS.index(layer(module))
    ]
    assert not late, f"imports of a later layer: {late}"


def test_no_module_imports_the_package_root():
    # `from sightline import x` counts too, except for a layer that is a module, which is then named in full.
    found = [
        f"{module}, line {line}"
        for module in MODULES
        for target, _, line in imports(module)
        if target == "sightline"
    ]
    assert not found, f"imports of the package root: {found}; name the module that defines it"


@pytest.mark.parametrize(("who", "banned"), BANS)
def test_banned_imports_do_not_happen(who, banned):
    found = [
        f"{module}, line {line}"
        for module in MODULES
        if layer(module) == who
        for target, _, line in imports(module)
        if target == banned or target.startswith(banned + ".")
    ]
    assert not found, f"{who} imports {banned}: {found}"


def test_the_imports_have_no_cycle():
    graph = {
        module: sorted({target for target, _, _ in imports(module)} - {"sightline"}) for module in MODULES
    }
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, f"imports go round: {' -> '.join([*path[path.index(module) :], module])}"
        if module not in done:
            for target in graph.get(module, ()):
                visit(target, (*path, module))
            done.add(module)

    for module in MODULES:
        visit(module, ())


def lines_of_annotations_only(module: str) -> set[int]:
    """All lines below ``if TYPE_CHECKING:``, which no program runs."""
    return {
        inner.lineno
        for node in nodes(module)
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")
        for branch in node.body
        for inner in ast.walk(branch)
        if hasattr(inner, "lineno")
    }


def test_every_module_is_reached_from_a_command_or_a_public_name():
    # The command line begins in one module and names its commands there; public names are loaded by the root.
    root = ast.literal_eval(
        next(
            node.value
            for node in tree_of("sightline").body
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_MODULE_OF"
        )
    )
    todo = ["sightline.__main__", *root.values()]
    reached: set[str] = set()
    while todo:
        module = todo.pop()
        if module in reached:
            continue
        reached.add(module)
        skipped = lines_of_annotations_only(module)
        todo += [target for target, _, line in imports(module) if line not in skipped and target in FILES]
    packages = {module for module in MODULES if FILES[module].name == "__init__.py"}
    left = set(MODULES) - reached - packages
    assert not left, (
        f"no command and no public name reaches {sorted(left)}: give them a door, or take them out"
    )


def test_every_public_name_has_a_docstring():
    bare = [
        f"{module}.{name}".rstrip(".")
        for module in sorted(FILES)
        for name, node in [("", tree_of(module)), *public_definitions(tree_of(module))]
        if not ast.get_docstring(node)
    ]
    assert not bare, f"no docstring on {bare}"


def test_no_module_takes_a_private_name_of_another():
    private = [
        f"{module}, line {line}: {name or target}"
        for module in MODULES
        for target, name, line in imports(module)
        if (name or target.rpartition(".")[2]).startswith("_")
    ]
    assert not private, f"imports of private names: {private}; make them public where they live"


def narrows_a_type(test: ast.expr) -> bool:
    """True for ``x is not None`` and ``isinstance(x, ...)``: facts for the type checker."""
    if isinstance(test, ast.Compare):
        return isinstance(test.ops[0], ast.IsNot) and ast.unparse(test.comparators[0]) == "None"
    return isinstance(test, ast.Call) and ast.unparse(test.func) == "isinstance"


def test_assert_never_checks_input():
    # An assert disappears under `python -O` and says nothing to the user.
    found = [
        f"{module}, line {node.lineno}"
        for module in MODULES
        for node in nodes(module)
        if isinstance(node, ast.Assert) and not narrows_a_type(node.test)
    ]
    assert not found, f"assert in {found}; raise one of sightline.errors"


def test_no_two_modules_define_a_public_class_of_the_same_name():
    places: dict[str, list[str]] = {}
    for module in MODULES:
        for node in tree_of(module).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(module)
    twice = {name: modules for name, modules in places.items() if len(modules) > 1}
    assert not twice, f"one name, two meanings: {twice}; call each by what it is"


def test_packages_below_the_root_hold_no_code():
    holding = [
        name
        for name, path in FILES.items()
        if path.name == "__init__.py"
        and name != "sightline"
        and any(not isinstance(node, ast.Expr) for node in tree_of(name).body)
    ]
    assert not holding, f"code in __init__.py of {holding}; give it a file with a name"


def test_no_file_names_a_place_on_somebodys_machine():
    absolute = re.compile(r"(?<![\w.~-])/(?:home|root|work|tmp|Users|private|mnt|opt|farm)/\w")
    kept = (
        [
            path
            for pattern in ("src", "tests", "examples", "docs", "benchmarks", "validation", "changelog.d")
            for path in (ROOT / pattern).rglob("*")
        ]
        + list(ROOT.glob("*.*"))
        + [ROOT / "Makefile", ROOT / ".ci" / "run"]
    )
    text = {".py", ".md", ".toml", ".txt", ".cff", ".yaml", ".yml", ".html", ".css", ".js", ".csv", ""}
    found = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in kept
        if path.is_file() and path.suffix in text and not {"__pycache__", ".git"} & set(path.parts)
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if absolute.search(line)
    ]
    assert not found, f"absolute paths in {found}"


def test_the_constraints_carry_hashes_and_no_address():
    files = sorted(ROOT.glob("constraints*.txt"))
    assert files
    for path in files:
        content = path.read_text(encoding="utf-8")
        assert ":" + "//" not in content, f"{path.name} names an address"
        pins = re.findall(r"^[a-z0-9][\w.-]*(?:\[[\w,]+\])?==", content, flags=re.MULTILINE)
        assert pins and content.count("--hash=sha256:") >= len(pins)


def test_kernels_are_compiled_and_kept_by_one_module_alone():
    # numba's own decorator refuses to start where the package and the home folder cannot be written.
    bypassing = [
        f"{module}, line {node.lineno}"
        for module in MODULES
        if module != "sightline.compiled"
        for node in nodes(module)
        if (isinstance(node, ast.Import) and any(alias.name.split(".")[0] == "numba" for alias in node.names))
        or (isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "numba")
    ]
    assert not bypassing, f"{bypassing} import numba; take njit from sightline.compiled"
