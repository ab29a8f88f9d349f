"""Pages of the report: docs/reports/mutation.md and mutation.zh.md, from mutation.json."""

from __future__ import annotations

from typing import Any

from mutation.report import ROOT

TITLES = {
    "en": ("Mutation testing", "[中文](mutation.zh.md)"),
    "zh": ("变异测试", "[English](mutation.md)"),
}
INTRO = {
    "en": """Each line of the protocols, the engine of the bus, the transaction, the scheduler, the permits, the start
permissives, the start, stop, pause and ramp hold and the authorization (users, sessions and tokens; leases, arm tokens
and waivers; the web's access checks) is changed in a small way, one change at a time, and a test of that package must
fail. A change that no test detects is an untested line. The tool is our own (`tests/mutation`): besides the bodies of
functions, also of decorated ones, it changes what is computed while a module is loaded: code tables, alphabets,
lengths, defaults.

```
make mutation                         # all modules; hours of processor time on a small machine
make mutation ARGS=drives.permissives        # one module
make mutation ARGS=--write            # write the figures and this page
```

Changes: a comparison by its neighbour and its opposite; `and` by `or`; a condition, a `not`, a bound, a statement, an
entry of a table left out; a number one more and one less; text with an additional letter; branches swapped;
None returned; a caught error raised again. Not changed: docstrings, annotations, decorators, asserts, the text of a
`ValueError`. Tests that take more than 0.3 s are left out, so a slow test may still detect a survivor.
Why not a published tool (measured on the scheduler, 211 changes, one core): this one takes 266 s of processor time.
mutmut 3.8 takes about 3.7 s a change (408 s for the first 110 of its 230) and leaves out what is computed while a
module is loaded and bodies of decorated functions: 938 and 226 of the 6,486 changes, code tables and rights among them.
cosmic-ray 8.7 changes these too, but starts the tests again for each of its 352 changes: 30 s each, 3 hours in all.
A commit that ends in "-dirty": merged from several runs between which tests were added, not yet confirmed by one run.
A row keeps its figures and its commit until its module is tried again; a module without a row has not been tried
under its current name.
""",
    "zh": """协议、总线引擎、事务、调度器、请求及其发送许可、启动允许条件、启动、停机、暂停和加减速禁止，
以及决定谁可以做什么的代码（用户、会话和令牌；控制权、启动令牌和豁免；网页的访问检查）的每一行都被逐一做微小改动，
该部分的测试必须发现。
没有测试发现的改动，就是未被测试的一行。工具是我们自己的（`tests/mutation`）：除函数体（包括带装饰器的函数）之外，
还改动模块加载时计算的内容：代码表、字符表、长度、默认值。

```
make mutation                         # 全部；小机器需要数小时
make mutation ARGS=drives.permissives        # 一个模块
make mutation ARGS=--write            # 保存数字并生成本页
```

改动的种类：比较符换成相邻的或相反的；`and` 与 `or` 互换；去掉一个条件、`not`、边界、语句或表项；数字加一或减一；
文字多一个字母；分支对调；不返回值；把捕获的错误再次抛出。不改动：文档字符串、类型注解、装饰器、断言、
`ValueError` 的文字。超过 0.3 秒的测试不参加，因此个别存活的改动仍可能被较慢的测试发现。
提交以“-dirty”结尾的行：由多次运行拼成，其间补充了测试，有的只用了该部分的一部分测试；尚未用一次完整运行确认。
一行的数字和提交保持到该模块再次运行；没有行的模块改用现名后尚未运行。
不用现成工具的原因（在调度器上实测，211 处改动，单核）：本工具用 266 秒处理器时间；
mutmut 3.8 每处改动约 3.7 秒（230 处中的前 110 处用了 408 秒），
而且不改动加载模块时执行的代码和带装饰器的函数体，
即这里 6,486 处改动中的 938 处和 226 处，其中有代码表和权限表；
cosmic-ray 8.7 也改动这些，但每处改动都重新启动测试（352 处，每处 30 秒）：
仅此模块就要 3 小时。
""",
}
HEAD = {
    "en": "| module | mutants | of them comparisons | while loading | killed | survived | killed % | commit |",
    "zh": "| 模块 | 改动数 | 其中比较 | 加载时 | 被发现 | 存活 | 发现率 % | 提交 |",
}
SURVIVORS = {
    "en": "## Survivors\n\nNone of them is a comparison that makes a difference; each line gives the reason.\n",
    "zh": "## 存活的改动\n\n其中没有会造成差别的比较；逐条的原因见英文页（[Survivors](mutation.md#survivors)）。\n",
}


def rows(found: dict[str, Any]) -> list[str]:
    """Return one table row for each module, and the sum."""
    made = [_row(module.removeprefix("drivebus."), figures, figures["commit"]) for module, figures in found.items()]
    total = {
        name: sum(figures[name] for figures in found.values())
        for name in ("mutants", "comparisons", "at_load", "killed")
    }
    return [*made, _row("**all**", total, "")]


def _row(name: str, row: dict[str, Any], commit: str) -> str:
    left, share = row["mutants"] - row["killed"], 100 * row["killed"] / row["mutants"] if row["mutants"] else 100.0
    counts = f"{row['mutants']} | {row['comparisons']} | {row['at_load']} | {row['killed']} | {left}"
    return f"| {name} | {counts} | {share:.1f} | {commit} |"


def survivors(found: dict[str, Any]) -> list[str]:
    return [
        f"- `{module.removeprefix('drivebus.')}:{survivor['line']}` {survivor['scope']}: "
        f"`{survivor['change']}`: {survivor['reason']}"
        for module, module_found in found.items()
        for survivor in module_found["survivors"]
    ]


def page(found: dict[str, Any], language: str) -> str:
    title, other = TITLES[language]
    table = "\n".join([HEAD[language], "| --- " * 8 + "|", *rows(found)])
    listed = "\n".join(survivors(found)) + "\n" if language == "en" else ""
    made = f"# {title}\n\n{other}\n\n{INTRO[language]}\n{table}\n\n"
    return f"{made}{SURVIVORS[language]}\n{listed}".rstrip() + "\n"


def write(found: dict[str, Any]) -> None:
    for language, name in (("en", "mutation.md"), ("zh", "mutation.zh.md")):
        (ROOT / "docs" / "reports" / name).write_text(page(found, language), encoding="utf-8")
