"""Structure of the code base before and after its rework, as figures (``make structure``).

Both columns come from the same code. A walk is the list of functions that one value or command passes through, written
by hand in ``structure_walks.json``; every function and file named there must exist, else the run fails.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from verification.ids import count_undefined

ROOT = Path(__file__).resolve().parents[1]
BEFORE = "29f1440"
"""Commit of the first column: the last one before the rework."""
WALKS = Path(__file__).with_name("structure_walks.json")
REPORT = ROOT / "docs" / "reports" / "structure"
WORDS = ("told", "said", "heard", "wish", "wished", "whoever", "nobody", "somebody", "anew")
_WORD = re.compile(rf"(?<![A-Za-z])({'|'.join(WORDS)})(?![A-Za-z])", re.IGNORECASE)
TITLES = {
    "en": {
        "title": "Structure, before and after",
        "intro": "Written by `make structure`. Left: commit {before}. Right: commit {after}. Same commands for both.",
        "measure": "measure",
        "before": "before",
        "after": "after",
        "walks": "Functions on the way",
        "walks_intro": "Listed by hand in `verification/structure_walks.json`; each named function exists.",
        "additions": "Files that an addition touches",
        "open": "–",
    },
    "zh": {
        "title": "结构：重构前后对比",
        "intro": "由 `make structure` 生成。左：提交 {before}；右：提交 {after}。两列用同一命令测得。",
        "measure": "指标",
        "before": "之前",
        "after": "之后",
        "walks": "一次处理经过的函数数",
        "walks_intro": "函数清单手工列于 `verification/structure_walks.json`，其中每个函数都存在。",
        "additions": "新增一项需改动的文件数",
        "open": "–",
    },
}
MEASURES = {
    "files": ("Python files of the package", "软件包的 Python 文件数"),
    "lines": ("lines of the package", "软件包的行数"),
    "product_files": ("files without the campaigns (`lab` before)", "不含验证活动（之前的 `lab`）的文件数"),
    "product_lines": ("lines without the campaigns", "不含验证活动的行数"),
    "product_statements": ("statements without the campaigns, docstrings excluded", "不含验证活动和文档字符串的语句数"),
    "median_lines": ("median lines of a file", "文件行数中位数"),
    "longest_lines": ("lines of the longest file", "最长文件的行数"),
    "longest_file": ("longest file", "最长的文件"),
    "verification_files": ("Python files of verification and benchmarks", "验证与基准测试的文件数"),
    "test_files": ("Python files of tests", "测试文件数"),
    "test_lines": ("lines of tests", "测试行数"),
    "cycles": ("import cycles (module level, `TYPE_CHECKING` included)", "导入环（含 `TYPE_CHECKING`）"),
    "runtime_cycles": ("import cycles at run time", "运行时导入环"),
    "single_use_helpers": ("private functions used once", "只用一次的私有函数"),
    "words": ("occurrences of " + ", ".join(WORDS), "上述词语的出现次数：" + "、".join(WORDS)),
    "undefined_ids": ("references to codes that no page defines", "没有页面定义的代号引用"),
    "declarations": (
        "modules that name one REST operation (`drive.run`), declaration and handler included, callers not",
        "写有一个 REST 操作名（`drive.run`）的模块数（含声明与处理函数，不含调用者）",
    ),
    "wheel_kb": ("wheel, kB", "wheel 大小（kB）"),
}


def main() -> int:
    options = argparse.ArgumentParser(prog="python -m verification.structure", description=__doc__)
    options.add_argument("checkout", nargs="?", type=Path, default=ROOT, help="the right column; this checkout if none")
    options.add_argument("--write", action="store_true", help="write docs/reports/structure.json and its pages")
    chosen = options.parse_args()
    with TemporaryDirectory() as folder:
        before = Path(folder) / "before"
        _git("worktree", "add", "--detach", str(before), BEFORE)
        try:
            found = {"before": measure(before, "before"), "after": measure(chosen.checkout, "after")}
        finally:
            _git("worktree", "remove", "--force", str(before))
    print(json.dumps(found, indent=1))
    if chosen.write:
        REPORT.with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        for language, suffix in (("en", ".md"), ("zh", ".zh.md")):
            REPORT.with_suffix(suffix).write_text(page(found, language), encoding="utf-8")
    return 0


def measure(root: Path, column: str) -> dict[str, object]:
    """Measure one checkout; ``column`` selects its walks."""
    package = sorted((root / "src" / "drivebus").rglob("*.py"))
    lines = {path: _line_count(path) for path in package}
    product = [path for path in package if "lab" not in path.parts]
    tests = sorted((root / "tests").rglob("*.py"))
    others = [*(root / "benchmarks").rglob("*.py"), *(root / "verification").rglob("*.py")]
    longest = max(package, key=lambda path: lines[path])
    walks = json.loads(WALKS.read_text(encoding="utf-8"))
    return {
        "commit": subprocess.check_output(
            ["git", "-C", str(root), "rev-parse", "--short=12", "HEAD"], text=True
        ).strip(),
        "files": len(package),
        "lines": sum(lines.values()),
        "product_files": len(product),
        "product_lines": sum(lines[path] for path in product),
        "product_statements": sum(map(_statement_count, product)),
        "median_lines": round(median(lines.values())),
        "longest_lines": lines[longest],
        "longest_file": longest.relative_to(root / "src" / "drivebus").as_posix(),
        "verification_files": len(others),
        "test_files": len(tests),
        "test_lines": sum(map(_line_count, tests)),
        "cycles": len(import_cycles(root / "src", typing=True)),
        "runtime_cycles": len(import_cycles(root / "src", typing=False)),
        "single_use_helpers": sum(map(single_use_helpers, package)),
        "words": sum(len(_WORD.findall(path.read_text(encoding="utf-8"))) for path in package),
        "undefined_ids": count_undefined(root),
        "declarations": operation_declarations(root),
        "wheel_kb": round(wheel_bytes(root) / 1000),
        "walks": {name: len(checked_walk(root, walk[column])) or None for name, walk in walks["walks"].items()},
        "additions": {
            name: len(checked_files(root, addition[column])) or None for name, addition in walks["additions"].items()
        },
    }


def _line_count(path: Path) -> int:
    return path.read_bytes().count(b"\n")


def _statement_count(path: Path) -> int:
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return sum(isinstance(node, ast.stmt) and not _is_string(node) for node in nodes)


def _is_string(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


# --- import cycles ----------------------------------------------------------------------------------------------------


def import_cycles(source: Path, *, typing: bool, packages: bool = False) -> list[list[str]]:
    """Return the groups of modules that import each other at module level.

    ``typing``: type-checking imports count; ``packages``: so do the packages of a module, which are imported before it.
    """
    names = {".".join(path.relative_to(source).with_suffix("").parts): path for path in source.rglob("*.py")}
    modules = {name.removesuffix(".__init__"): path for name, path in names.items()}
    graph: dict[str, set[str]] = {}
    for name, path in modules.items():
        imported = {
            module for imported_name in _imports(path, typing=typing) if (module := _module_of(imported_name, modules))
        }
        if packages:
            imported |= {package for module in imported for package in _packages(module)} - _packages(name)
        graph[name] = imported - {name}
    return [group for group in _components(graph) if len(group) > 1]


def _imports(path: Path, *, typing: bool) -> Iterator[str]:
    """Yield the full names that a module imports when it is loaded."""
    blocks: list[list[ast.stmt]] = [ast.parse(path.read_text(encoding="utf-8")).body]
    while blocks:
        for node in blocks.pop():
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                yield from (f"{node.module}.{alias.name}" for alias in node.names)
            elif isinstance(node, ast.If):
                is_typing = "TYPE_CHECKING" in ast.unparse(node.test)
                blocks += [node.orelse] if is_typing and not typing else [node.body, node.orelse]
            elif isinstance(node, ast.Try):
                blocks += [node.body, node.orelse, *(handler.body for handler in node.handlers)]
            elif isinstance(node, ast.ClassDef):
                blocks.append(node.body)


def _module_of(name: str, modules: dict[str, Path]) -> str | None:
    """Return the module that this name is, or is in."""
    return name if name in modules else parent if (parent := name.rpartition(".")[0]) in modules else None


def _packages(name: str) -> set[str]:
    """Return the packages that hold a module."""
    parts = name.split(".")
    return {".".join(parts[:count]) for count in range(1, len(parts))}


def _components(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected components of a graph (Tarjan)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph[node]):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            at = stack.index(node)
            found.append(sorted(stack[at:]))
            del stack[at:]

    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(10_000)
    for node in sorted(graph):
        if node not in index:
            visit(node)
    sys.setrecursionlimit(limit)
    return found


# --- other figures ----------------------------------------------------------------------------------------------------


def single_use_helpers(path: Path) -> int:
    """Return how many private functions and methods of a module are named once in it beside their definition."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    uses = Counter(
        node.id if isinstance(node, ast.Name) else node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Name | ast.Attribute)
    )
    defined = [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    return sum(uses[name] == 1 for name in defined if name.startswith("_") and not name.startswith("__"))


def operation_declarations(root: Path) -> int:
    """Return how many modules and catalogues name the operation ``drive.run`` or its path; ``cli`` only calls it."""
    literal = re.compile(r"[\"'](?:drive\.run|/(?:api/v1/)?drives/\{drive\}/run|api\.drive\.run[a-z_.]*)[\"']")
    package = root / "src" / "drivebus"
    files = [*package.rglob("*.py"), *(package / "i18n").glob("*.en.json")]
    return sum(
        bool(literal.search(path.read_text(encoding="utf-8")))
        for path in files
        if path.relative_to(package).parts[0] != "cli"
    )


def wheel_bytes(root: Path) -> int:
    """Return the size of the wheel that this checkout builds."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder]
        subprocess.run(command, cwd=root, check=True, capture_output=True)
        return sum(path.stat().st_size for path in Path(folder).glob("*.whl"))


def checked_walk(root: Path, walk: list[str]) -> list[str]:
    """Return the functions of a walk: "folder/file.py: one two three". Raises ValueError for one that is not there."""
    found: list[str] = []
    for line in walk:
        file, _, functions = line.partition(":")
        path = root / "src" / "drivebus" / file
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        for name in functions.split():
            if not re.search(rf"\b(?:def|class|function|const) {re.escape(name)}\b", text):
                raise ValueError(f"{file} has no function {name}")
            found.append(f"{file}:{name}")
    return found


def checked_files(root: Path, files: list[str]) -> list[str]:
    """Return the files that an addition touches; a name ending in "+" is new. Raises ValueError for one not there."""
    for file in files:
        if not file.endswith("+") and not any(root.glob(file)):
            raise ValueError(f"{root} has no {file}")
    return files


def page(found: dict[str, dict[str, object]], language: str) -> str:
    """Return the report's page."""
    titles = TITLES[language]
    place = ("en", "zh").index(language)
    other = "[中文](structure.zh.md)" if language == "en" else "[English](structure.md)"
    head = [f"| {titles['measure']} | {titles['before']} | {titles['after']} |", "| --- | --- | --- |"]
    commits = {name: str(figures["commit"]) for name, figures in found.items()}

    def row(name: str, before: object, after: object) -> str:
        return (
            "| "
            + " | ".join([name, *(titles["open"] if figure is None else str(figure) for figure in (before, after))])
            + " |"
        )

    rows = [row(texts[place], found["before"][key], found["after"][key]) for key, texts in MEASURES.items()]
    tables = {}
    for part in ("walks", "additions"):
        before, after = found["before"][part], found["after"][part]
        assert isinstance(before, dict) and isinstance(after, dict)
        names = json.loads(WALKS.read_text(encoding="utf-8"))[part]
        tables[part] = [*head, *(row(names[key][language], before[key], after[key]) for key in before)]
    return "\n".join(
        [
            f"# {titles['title']}",
            "",
            other,
            "",
            titles["intro"].format(**commits),
            "",
            *head,
            *rows,
            "",
            f"## {titles['walks']}",
            "",
            titles["walks_intro"],
            "",
            *tables["walks"],
            "",
            f"## {titles['additions']}",
            "",
            *tables["additions"],
            "",
        ]
    )


def _git(*arguments: str) -> None:
    subprocess.run(["git", "-C", str(ROOT), *arguments], check=True, capture_output=True)


if __name__ == "__main__":
    sys.exit(main())
