# SPDX-License-Identifier: Apache-2.0
"""Every code block of every page is run, or what it names is looked for; `make docs-test` runs those that take long."""

from __future__ import annotations

import collections
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from softgrip_testing.free_domains import FreeDomains
from softgrip_testing.scripts import load_script
from softgrip_vision.calibrating import has_charuco

pytest.importorskip("embedded_ros", reason="its parsers know the names on the pages")

ROOT = Path(__file__).resolve().parents[2]
LONG = bool(os.environ.get("SOFTGRIP_LONG_BLOCKS"))


#: Pages whose language is held to the aims of tools/pages/word_counts.py: all but those that the site's build writes.
WRITTEN = [*ROOT.glob("*.md"), ROOT / "embedded/README.md"]
WRITTEN += [path for path in (ROOT / "docs").rglob("*.md") if "generated" not in path.parts]


#: Why a block is not run anywhere -> blocks with this reason. What they name is still looked for (blocks.check_names).
NOT_RUN = {
    "236 solids take an hour; `make bench` does it": 1,
    "changes the environment; `make setup` does it": 1,
    "downloads 500 MB and opens a window; `make long-tests` reads such a file with Rerun": 1,
    "downloads 660 MB; `make docs-test` has done it": 2,
    "needs ROS 2 Jazzy": 3,
    "needs ROS 2 Jazzy and a camera": 1,
    "needs RViz and ros2_control of ROS 2 Jazzy": 1,
    "needs ros2_control of ROS 2 Jazzy": 2,
    "needs a camera that sees your hand": 1,
    "needs a film of your hand": 2,
    "sets the project up": 2,
    "sets the project up, builds and tests it": 1,
    "sets the project up; the first tutorial runs the demo": 2,
    "the tutorial of the first shift runs it": 1,
    "writes udev rules for your devices": 1,
}
#: What ROS 2 gives every node.
STANDARD_SERVICES = {"get_parameters", "set_parameters", "get_state"}


def tool(name: str) -> ModuleType:
    return load_script(ROOT / "tools/pages" / f"{name}.py")


blocks = tool("blocks")
links = tool("links")
named = tool("named")
word_counts = tool("word_counts")
PAGES = blocks.pages()


@pytest.fixture(scope="session")
def running_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Give what commands need to reach the one emulated cell that all pages share; its friction is measured."""
    folder, domains = tmp_path_factory.mktemp("cell"), FreeDomains(start=os.getpid())
    domain = domains.take_domain()
    variables = {"ROS_DOMAIN_ID": str(domain), "ROS_HOME": str(folder)}
    environment = os.environ | variables | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    launch = ["ros2", "launch", "softgrip_bringup", "cell.launch.yaml", "speed:=max", "panel:=false"]
    launch += [f"out:={folder}/out", f"wire_dir:={folder}/wires"]
    with (folder / "cell.log").open("w") as log:
        cell = subprocess.Popen(launch, env=environment, stdout=log, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        measure = [sys.executable, str(ROOT / "tools/pages/hands.py"), "measure"]
        done = subprocess.run(measure, env=environment, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr + (folder / "cell.log").read_text()[-4000:]
        yield variables
    finally:
        os.killpg(cell.pid, signal.SIGINT)
        cell.wait(60)
        domains.release(domain)


@pytest.mark.timeout(1200 if LONG else 120)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_says_to_type_works(page: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if page.name == "own-camera.md" and not has_charuco():
        pytest.skip("it prints ChArUco boards, which OpenCV 4.7 and later know")
    cell = request.getfixturevalue("running_cell") if LONG and blocks.needs_cell(page) else None
    blocks.Reader(tmp_path, long=LONG, cell=cell).run(page)


def test_what_is_not_run_has_one_of_these_reasons() -> None:
    """A reason that is not listed is looked at before it is accepted here: can it not be run all the same?"""
    found = [block.value for page in PAGES for block in blocks.blocks_of(page) if block.mark == "elsewhere"]
    assert collections.Counter(found) == NOT_RUN


@pytest.mark.parametrize(
    "value",
    [
        "tests/documents/test_library.py::test_no_such",
        "tests/documents/test_no_such.py::test_the_wheel_does_without_ros_and_without_the_repository",
        "tests/documents/test_library.py::test_the_wheel_does_without_ros_and_without_the_repository",  # another page
        "",
    ],
)
def test_a_block_that_another_test_runs_names_one_that_reads_its_page(
    value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"<!-- by: {value} -->\n```sh\nmake demo\n```\n")
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    monkeypatch.setattr(blocks, "ROOT", tmp_path)
    with pytest.raises(blocks.BlockError):
        blocks.blocks_of(page)


def test_beside_a_cell_a_page_types_what_another_terminal_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "<!-- background: token -->\n```sh\necho token: 1a2b; sleep 5\n```\n\n"
        "<!-- stands: eins for one -->\n\n"
        "<!-- cell: 0f2c from token: (\\w+) -->\n```sh\necho 0f2c one $ROS_DOMAIN_ID $OTHER_DOMAIN\n```\n\n"
        "<!-- output -->\n```text\n1a2b eins 7 107\n```\n\n"
        "<!-- cell -->\n```sh\nread answer; echo \"answered '$answer'\"\n```\n\n"
        "<!-- output -->\n```text\nanswered ''\n```\n"
    )
    monkeypatch.setattr(blocks, "ROOT", tmp_path)
    monkeypatch.setattr(blocks, "TOP", ())
    assert blocks.Reader(tmp_path, long=True, cell={"ROS_DOMAIN_ID": "7"}).run(page) == 6


def test_a_service_that_refuses_fails_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- cell -->\n```sh\necho 'Trigger_Response(success=False)'\n```\n")
    monkeypatch.setattr(blocks, "ROOT", tmp_path)
    monkeypatch.setattr(blocks, "TOP", ())
    with pytest.raises(blocks.BlockError, match="success=False"):
        blocks.Reader(tmp_path, long=True, cell={}).run(page)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_python_can_be_pasted_at_its_prompt(page: Path) -> None:
    for block in blocks.blocks_of(page):
        if block.language == "python" and block.mark != "file":
            blocks.check_at_prompt(block)


@pytest.mark.parametrize(
    ("text", "takes"),
    [
        ("x = 1\nfor i in range(2):\n    print(i)\n\nprint(x)\n", True),
        ("for i in range(2):\n    print(i)\n", True),  # Enter once more
        ("call(\n    1,\n\n    2,\n)\n", True),
        ("for i in range(2):\n    print(i)\nprint(i)\n", False),
        ("def f():\n    x = 1\n\n    return x\n", False),
        ("if a:\n    b()\n\nelse:\n    c()\n", False),
        ("call(\n    1,\n", False),
    ],
)
def test_what_pythons_prompt_takes(text: str, *, takes: bool) -> None:
    """As in the tutorial of Python's documentation: a blank line ends a block, and only that does."""
    block = blocks.Block(ROOT / "page.md", 1, "python", text)
    if takes:
        blocks.check_at_prompt(block)
    else:
        with pytest.raises(blocks.BlockError, match="prompt"):
            blocks.check_at_prompt(block)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_running_text_names_is_there(page: Path) -> None:
    assert list(blocks.text_problems(page)) == []


@pytest.mark.parametrize("page", sorted(WRITTEN), ids=lambda page: str(page.relative_to(ROOT)))
def test_sentences_and_paragraphs_are_short(page: Path) -> None:
    found = word_counts.statistics_of(page.read_text(encoding="utf-8"))
    assert found.mean <= word_counts.MAX_MEAN_WORDS
    assert found.longest <= word_counts.MAX_PARAGRAPH_WORDS


def test_words_and_sentences_are_counted_without_tables_and_code() -> None:
    running = "One two three. Four: five, e.g. six?\n\n* seven `eight`"  # nine words, four ends, seven in the first
    text = f"# A b c\n\n    code is left out\n\n|a|b|\n|---|---|\n|c d|e|\n\n![p](p.png)\n\n{running}\n"
    found = word_counts.statistics_of(text)
    assert (found.words, found.sentences, found.longest, found.figures, found.table_rows) == (9, 4, 7, 1, 2)


def test_every_link_leads_somewhere() -> None:
    assert [str(problem) for problem in links.check()] == []


def test_a_broken_link_and_a_page_in_no_contents_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/index.md").write_text("# Top\n\n```{toctree}\nthere\nnowhere\n```\n\n[a](there.md#good-news)\n")
    (tmp_path / "docs/there.md").write_text(
        "# Good news\n\n[b](gone.md) [c](index.md#no) ![d](no.png) [e](https://x.y)\n"
    )
    (tmp_path / "docs/lost.md").write_text("# Lost\n")
    monkeypatch.setattr(links, "ROOT", tmp_path)
    monkeypatch.setattr(links, "ROOT_PAGE", tmp_path / "docs/index.md")
    monkeypatch.setattr(links, "pages", lambda: sorted(tmp_path.rglob("*.md")))
    found = [str(problem) for problem in links.check()]
    assert [line.partition(":")[0] for line in found] == ["docs/there.md"] * 3 + ["docs/index.md", "docs/lost.md"]


@pytest.mark.parametrize(
    ("expected", "printed", "same"),
    [
        ("tip at 12.3 mm", "tip at 12.4 mm", True),
        ("tip at 12.3 mm", "tip at 12.6 mm", False),
        ("tip at 12.3 mm", "top at 12.3 mm", False),
        ("found in ... s", "found in 0.11 s", True),
        ("found in ... s", "lost in 0.11 s", False),
    ],
)
def test_output_is_compared_by_words_and_numbers(expected: str, printed: str, *, same: bool) -> None:
    assert blocks.alike(expected, printed) is same


def test_a_page_that_says_something_else_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text("```python\nprint(1 + 1)\n```\n\n<!-- output -->\n```text\n4\n```\n")
    monkeypatch.setattr(blocks, "ROOT", tmp_path)
    monkeypatch.setattr(blocks, "TOP", ())
    with pytest.raises(blocks.BlockError, match="expected the line"):
        blocks.Reader(tmp_path).run(page)


@pytest.mark.parametrize(
    "line",
    [
        "ros2 run softgrip_model predicts",
        "ros2 run softgrip_model predict --profiel power",
        "ros2 run softgrip_bag replay BAG --through no_node",
        "ros2 run softgrip_driver tendon_driver --ros-args -p loop_rat:=100.0",
        "ros2 run softgrip_driver tendon_driver --ros-args -p loop_rate:=1.0e9",
        "ros2 run softgrip_grip grip",
        "ros2 launch softgrip_bringup cell.launch.yaml cells:=2",
        "ros2 launch softgrip_bringup cell.launch.yaml hardware:=wooden",
        "ros2 launch softgrip_bringup cel.launch.yaml",
        "ros2 service call /estpo std_srvs/srv/Trigger",
        "ros2 service call /estop std_srvs/srv/SetBool",
        "ros2 service call /cell/select_product softgrip_interfaces/srv/SelectProduct '{produkt: egg}'",
        "ros2 service call /cell/plan_mix softgrip_interfaces/srv/PlanMix '{quantities: [many]}'",
        "ros2 service cal /estop std_srvs/srv/Trigger",
        "ros2 action send_goal /cell/grap softgrip_interfaces/action/Grasp",
        "ros2 action send_goal /cell/grasp softgrip_interfaces/action/Grasp '{products: egg}'",
        "ros2 topic echo --twice /cell/state",
        "ros2 topic echo /cell/stat",
        "ros2 topic pub /teleoperation/dead_man std_msgs/msg/Bool '{data: maybe}'",
        "ros2 param set /tendon_driver loop_rat 100.0",
        "ros2 bag record --every",
        "ros2 node info /tendondriver",
        "ros2 lifecycle set /no_driver configure",
        "ros2 interface show softgrip_interfaces/msg/NoState",
        "ros2 pkg prefix softgrip_grip",
        "make cofee",
        "make demo SEEDS=2",
        "python -m softgrip_model.frictions",
        "python tools/no_tool.py",
        "python tools/pages/word_counts.py --limits README.md",
        "pip install -r requirements-none.lock",
        "cd ros2_ws && make cofee",
        "cp $(ros2 pkg prefix softgrip_grip)/a b",
        "no_program at all",
    ],
)
def test_a_command_that_does_not_exist_is_found_without_running_it(line: str) -> None:
    block = blocks.Block(ROOT / "docs/index.md", 1, "sh", line)
    with pytest.raises(blocks.BlockError):
        blocks.check_names(block)


@pytest.mark.parametrize(
    "text",
    [
        "ros2 launch softgrip_bringup cell.launch.yaml cel:=left",
        "ros2 run softgrip_bag export --lerobots",
        "make demoo",
        "softgrip_model.fingers",
        "softgrip_model.finger.no_such_name",
        "tools/pages/blokcs.py",
        "tendon/mvoe",
    ],
)
def test_running_text_that_names_what_is_not_there_is_found(text: str) -> None:
    assert named.text_problem(text)


@pytest.mark.parametrize(
    "text",
    [
        "ros2 launch",
        "ros2 run PACKAGE EXECUTABLE",
        "ros2 run softgrip_bag export --lerobot OUT BAG...",
        "ros2 topic echo /left/cell/state",
        "make demo SEED=2",
        "softgrip_model.finger.close",
        "tools/pages/blocks.py",
        "tendon/move",
        "and/or",
    ],
)
def test_running_text_that_names_what_is_there_passes(text: str) -> None:
    assert named.text_problem(text) == ""


def test_a_parameter_file_is_held_to_the_tables() -> None:
    assert named.parameter_problem({"/**/camera": {"ros__parameters": {"no_such": 1}}})
    assert named.parameter_problem({"schema": 1, "parameters": {"panel": {"host": 1}}})
    assert named.parameter_problem({"schema": 1, "parameters": {"panel": {"host": "0.0.0.0"}}}) == ""


@pytest.mark.parametrize(
    "text",
    ["    make demo\n", "```\nmake demo\n```\n", "```yaml\na: 1\n```\n", "<!-- elsewhere -->\n```sh\nmake demo\n```\n"],
)
def test_a_block_says_what_it_is_and_why_it_is_not_run(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"# Page\n\n{text}")
    monkeypatch.setattr(blocks, "ROOT", tmp_path)
    with pytest.raises(blocks.BlockError):
        blocks.blocks_of(page)


def test_what_is_hidden_is_run_where_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        '<!-- hidden: echo "made" > file -->\n\n```sh\ncat file\n```\n\n<!-- output -->\n```text\nmade\n```\n'
    )
    monkeypatch.setattr(blocks, "ROOT", tmp_path)
    monkeypatch.setattr(blocks, "TOP", ())
    assert blocks.Reader(tmp_path).run(page) == 3


def test_links_of_the_generated_reference_lead_somewhere() -> None:
    reference = load_script(ROOT / "tools/docs/reference.py")
    folder = ROOT / "docs/reference/generated"
    broken = [
        f"{name}: {target}"
        for name, text in reference.pages().items()
        for target in re.findall(r"\]\(([^)#:]+\.md)(?:#[^)]*)?\)", text)
        if target.startswith("..")
        and not (folder / name).parent.joinpath(target).resolve().is_relative_to(folder)
        and not (folder / name).parent.joinpath(target).resolve().is_file()
    ]
    assert broken == []


def test_every_topic_service_and_action_is_explained() -> None:
    made = {name for _, name in named.ros_names.interfaces.endpoints()}
    explained = set(named.ros_names.interfaces.meanings())
    standard = {"/clock"} | {name for name in made if name.rpartition("/")[2] in STANDARD_SERVICES}
    assert {name for name in made if not name.startswith("~")} - explained <= standard


def test_every_type_of_the_cores_headers_has_a_heading_with_its_comment() -> None:
    made = load_script(ROOT / "tools/docs/reference.py").pages()
    for name, (_, _, package, pattern) in load_script(ROOT / "tools/pages/generated/cpp.py").PAGES.items():
        page = made[f"cpp/{name}.md"]
        headings = re.findall(r"^### `(.*)`$", page, re.MULTILINE)
        for header in (ROOT / "ros2_ws/src" / package / "include/softgrip").glob(pattern):
            text = header.read_text()
            if not header.name.endswith("-inl.hpp"):
                for kind in re.findall(r"^(?:class|struct|enum class) (\w+)[^;]*\{", text, re.MULTILINE):
                    assert kind in headings, (header.name, kind)
    law = made["cpp/finger.md"].partition("### `KReading`")[2]
    assert law.startswith("\n\nReading of K in Eq 3.8. Printed: K = -x, as the thesis prints it.")
    solver = made["cpp/gdfe.md"].partition("### `Solver`")[2].partition("\n### ")[0]
    assert "Outcome solve(const Task& task" in solver
    assert "measure_balance" not in solver  # private


def test_every_package_has_a_page_of_its_python_api() -> None:
    reference = load_script(ROOT / "tools/docs/reference.py")
    on_pages = {title.partition(".")[0] for title, _, _ in reference.api.PAGES.values()}
    without_python = {"softgrip_bringup", "softgrip_cmake", "softgrip_interfaces", "softgrip_mcap_vendor"}
    packages = {path.parent.name for path in (ROOT / "ros2_ws/src").glob("*/package.xml")}
    assert packages - on_pages == without_python
