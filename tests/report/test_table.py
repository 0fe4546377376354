"""Many runs in one table: spread, best, published figures, protocols that may not mix, runs that are missing."""

import json
import shutil
import statistics
from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from xrdslam.core.errors import PluginError, RunError
from xrdslam.core.records import AlgorithmInfo
from xrdslam.core.registry import installed
from xrdslam.report.__main__ import main
from xrdslam.report.formats import FORMATS, as_csv, as_html, as_latex, as_markdown
from xrdslam.report.protocols import ProtocolError
from xrdslam.report.published import PublishedFigure, published_figure, published_figures
from xrdslam.report.run_files import RunFiles, read_run
from xrdslam.report.sweep import asked_for
from xrdslam.report.table import tabulated

ATE, PSNR = "trajectory/final/ate_rmse_cm", "rendering/train/psnr_db"
Vary = Callable[..., Path]


@pytest.fixture
def vary(toy_run: Path, tmp_path: Path) -> Vary:
    """Return a function that copies the run and changes settings and figures of the copy."""

    def make(name: str, figures: dict[str, object] | None = None, **settings: object) -> Path:
        folder = tmp_path / name
        shutil.copytree(toy_run, folder, ignore=shutil.ignore_patterns("renders", "map"))
        config = OmegaConf.load(folder / "config.yaml")
        for key, value in settings.items():
            OmegaConf.update(config, key.replace("__", "."), value)
        OmegaConf.save(config, folder / "config.yaml")
        metrics = json.loads((folder / "metrics.json").read_text()) | (figures or {})
        (folder / "metrics.json").write_text(json.dumps(metrics))
        return folder

    return make


def read(*folders: Path) -> list[RunFiles]:
    return [read_run(folder) for folder in folders]


def other(name: str) -> dict[str, object]:
    return {"algo__name": name, "algo__tracking__name": name, "algo__mapping__name": name}


def test_rows_are_means_over_seeds_with_the_samples_spread(vary: Vary) -> None:
    runs = read(*(vary(f"s{i}", {ATE: value}, seed=i) for i, value in enumerate((1.0, 2.0, 4.0))))
    table = tabulated(runs, keys=[ATE])
    (row,) = table.rows
    assert row.seeds == (0, 1, 2)
    assert row.cells[0].mean == pytest.approx(7 / 3)
    assert row.cells[0].std == pytest.approx(statistics.stdev([1, 2, 4]))
    assert "| toy/room0 | toy | 0, 1, 2 | 2.33 ± 1.53 |" in as_markdown(table)


def test_the_best_is_bold_by_its_direction_and_only_among_rivals(vary: Vary) -> None:
    worse = vary("a", {ATE: 3.0, PSNR: 20.0})
    better = vary("b", {ATE: 1.0, PSNR: 30.0}, **other("rival"))
    alone = vary("c", {ATE: 9.0, PSNR: 9.0}, dataset__scene="attic")
    table = tabulated(read(worse, better, alone), keys=[ATE, PSNR])
    assert {row.method: [cell.is_best for cell in row.cells] for row in table.rows[:2]} == {
        "toy": [False, False],
        "rival": [True, True],
    }
    assert not any(cell.is_best for cell in table.rows[2].cells)
    assert "**1.00**" in as_markdown(table)
    assert "\\textbf{1.00}" in as_latex(table)
    assert "<b>1.00</b>" in as_html(table)


def test_groups_of_one_name_say_what_tells_them_apart(vary: Vary) -> None:
    plain, tuned = vary("a"), vary("b", algo__keyframe_every=7)
    longer, mixed = vary("c", dataset__frames=[0, 99, 1]), vary("d", algo__tracking__name="gicp", preset="fast")
    table = tabulated(read(plain, tuned, longer, mixed), keys=[ATE])
    assert [(row.dataset, row.method) for row in table.rows] == [
        ("toy/room0 dataset.frames=[0,null,1]", "toy algo.keyframe_every=5"),
        ("toy/room0 dataset.frames=[0,null,1]", "toy algo.keyframe_every=7"),
        ("toy/room0 dataset.frames=[0,null,1]", "toy tracking=gicp (fast)"),
        ("toy/room0 dataset.frames=[0,99,1]", "toy"),
    ]


def test_where_a_run_wrote_and_how_it_was_watched_tells_nothing_apart(vary: Vary) -> None:
    runs = read(vary("a", seed=0), vary("b", seed=1, run_dir="elsewhere", report=False, engine__progress=False))
    assert len(tabulated(runs, keys=[ATE]).rows) == 1


def with_protocol(folder: Path, group: str, **changes: object) -> Path:
    metrics = json.loads((folder / "metrics.json").read_text())
    metrics[f"{group}/protocol"] |= changes
    (folder / "metrics.json").write_text(json.dumps(metrics))
    return folder


def test_two_protocols_in_one_column_are_refused_with_what_differs_and_what_to_do(vary: Vary) -> None:
    runs = read(vary("one"), with_protocol(vary("two", seed=1), "rendering/train", mask="none"))
    with pytest.raises(ProtocolError, match=r"rendering/train .*mask is valid_depth in one and none in two.*--split"):
        tabulated(runs)
    assert len(tabulated(runs, keys=[ATE]).rows) == 1  # measured alike
    split = tabulated(runs, is_split=True, keys=[PSNR])
    assert [column.note for column in split.columns] == ["mask=valid_depth", "mask=none"]
    assert [len(cell.values) for cell in split.rows[0].cells] == [1, 1]


def test_what_came_out_and_what_is_of_other_figures_is_no_protocol(vary: Vary) -> None:
    changed = with_protocol(vary("b", seed=1), "trajectory/final", matched_frames=3, rpe_delta_frames=5)
    runs = read(vary("a"), changed)
    assert len(tabulated(runs, keys=[ATE]).rows) == 1
    with pytest.raises(ProtocolError, match="rpe_delta_frames is 1 in a and 5 in b"):
        tabulated(runs, keys=["trajectory/final/rpe_translation_rmse_cm"])


def test_speed_on_other_threads_is_another_protocol(vary: Vary) -> None:
    runs = read(vary("a"), with_protocol(vary("b", seed=1), "profile", threads="2"))
    with pytest.raises(ProtocolError, match="threads is 1 in a and 2 in b"):
        tabulated(runs)


FIGURES = [
    PublishedFigure("toy", "room0", ATE, 0.5, "the paper, table 1"),
    PublishedFigure("toy", "mean of 8", ATE, 0.9, "the paper, table 2"),
]


def test_published_figures_stand_beside_with_their_source(vary: Vary) -> None:
    exact, mean = vary("a"), vary("b", dataset__scene="attic")
    own, foreign = vary("c", dataset__scene="custom"), vary("d", algo__tracking__name="gicp")
    table = tabulated(read(exact, mean, own, foreign), published={"toy": FIGURES}, keys=[ATE])
    found = {(row.dataset, row.method): row.cells[0].published for row in table.rows}
    assert found == {
        ("toy/room0", "toy"): FIGURES[0],
        ("toy/room0", "toy tracking=gicp"): None,  # not what was published
        ("toy/attic", "toy"): FIGURES[1],
        ("toy/custom", "toy"): None,  # a scene of the user's own
    }
    text = as_markdown(table)
    assert "(published 0.5 [1])" in text
    assert "[2] toy, mean of 8: the paper, table 2" in text


def test_every_installed_plugin_brings_figures_that_can_be_read() -> None:
    for name, info in installed().all(AlgorithmInfo).items():
        for figure in published_figures(info):
            assert figure.value > 0, name
            assert len(figure.source) > 10
            assert figure.metric.count("/") >= 1


def test_figures_that_cannot_be_read_name_the_plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "figs").mkdir()
    (tmp_path / "figs" / "published.yaml").write_text("figures: [{dataset: toy, value: 1}]")
    monkeypatch.syspath_prepend(tmp_path)
    info = AlgorithmInfo("mine", "", published="figs:published.yaml", distribution="mine 1.0")
    with pytest.raises(PluginError, match=r"'mine' of mine 1.0.*figs:published.yaml"):
        published_figures(info)
    with pytest.raises(PluginError, match="cannot be read"):
        published_figures(AlgorithmInfo("mine", "", published="nowhere:published.yaml"))
    assert published_figures(AlgorithmInfo("mine", "")) == []
    assert published_figure([], "toy/room0", ATE) is None


def sweep(tmp_path: Path, vary: Vary) -> Path:
    """A sweep of five of which two finished, one is not done yet, one failed half way and one was never begun."""
    names = ("algo=toy,seed=0", "algo=toy,seed=1", "algo=rival,seed=0", "algo=rival,seed=1", "algo=rival,seed=2")
    folder = tmp_path / "sweep"
    for name in names[:4]:
        run = vary(f"sweep/{name}", seed=int(name[-1]), **(other("rival") if "rival" in name else {}))
        status = "failed" if name == "algo=rival,seed=1" else "done"
        (run / "job.json").write_text(json.dumps({"status": status, "reason": "no disk" * (status == "failed")}))
    (folder / "algo=rival,seed=0" / "metrics.json").unlink()
    jobs = {name: [*name.split(","), "dataset=toy/room0"] for name in names}
    (folder / "sweep.json").write_text(json.dumps({"call": "now", "jobs": jobs, "side_by_side": 1}))
    return folder


def test_a_half_finished_sweep_gives_what_there_is_and_names_the_rest(tmp_path: Path, vary: Vary) -> None:
    asked = asked_for([sweep(tmp_path, vary)])
    table = tabulated(asked.runs, asked.missing)
    assert [(row.method, row.seeds) for row in table.rows] == [("toy", (0, 1))]
    assert table.missing == (
        "algo=rival,seed=0 (rival on toy/room0, seed 0) has no figures: it runs yet or was ended",
        "algo=rival,seed=1 (rival on toy/room0, seed 1) failed: no disk",  # though it left figures of some frames
        "algo=rival,seed=2 (algo=rival seed=2 dataset=toy/room0) was not started",
    )
    assert "Missing, 3 of the runs" in as_markdown(table)


def test_the_command_writes_every_format(tmp_path: Path, vary: Vary, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    main([str(sweep(tmp_path, vary)), "--format", ",".join(FORMATS), "--out", str(out)])
    assert capsys.readouterr().out.split() == [str(out / file) for file, _ in FORMATS.values()]
    assert (out / "report.tex").read_text().count("\\\\") == 2
    lines = (out / "report.csv").read_text().splitlines()
    assert lines[0].startswith("dataset,method,metric,protocol,unit,seeds,mean,std,values")
    page = (out / "report.html").read_text()
    assert "//" not in page.replace("<!doctype", "").partition("<body>")[2]
    main([str(tmp_path / "sweep"), "--columns", ATE])
    assert "| dataset | method | seeds | ATE RMSE [cm] |" in capsys.readouterr().out


def test_one_run_gets_its_page(vary: Vary, capsys: pytest.CaptureFixture[str]) -> None:
    run = vary("a")
    main([str(run), "--gt-mesh", str(run / "true_mesh.ply")])
    assert capsys.readouterr().out.strip() == str(run / "report.html")
    assert (run / "report.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: no such folder"),
        (["."], "holds no run"),
        (["a", "--columns", "trajectory/nothing"], "none of the runs has it"),
        (["a", "--format", "word"], "--format word: must be among markdown, csv, latex, html"),
    ],
)
def test_what_a_user_can_mend_is_one_line(
    arguments: list[str], message: str, vary: Vary, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    where = [str(vary("a")) if argument == "a" else argument for argument in arguments]
    with pytest.raises(SystemExit, match=message):
        main(where)


def test_runs_without_figures_alone_make_no_table(vary: Vary) -> None:
    folder = vary("a")
    (folder / "metrics.json").unlink()
    with pytest.raises(RunError, match="none of 1 runs has figures"):
        tabulated(read(folder))


def test_csv_has_each_value_of_each_seed(vary: Vary) -> None:
    table = tabulated(read(vary("a", {ATE: 1.25}), vary("b", {ATE: 2.5}, seed=1)), keys=[ATE])
    assert as_csv(table).splitlines()[1] == f"toy/room0,toy,{ATE},,cm,0 1,1.875,0.88388348,1.25 2.5,,"
