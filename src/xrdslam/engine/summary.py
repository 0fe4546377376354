"""The end of a run on one screen."""

from pathlib import Path

from rich.table import Table

from xrdslam.evaluation import Metrics

__all__ = ["summary_table"]

ROWS = (
    ("trajectory/final/ate_rmse_cm", "ATE RMSE, final trajectory", "cm", 3),
    ("trajectory/online/ate_rmse_cm", "ATE RMSE, online trajectory", "cm", 3),
    ("trajectory/final/rpe_translation_rmse_cm", "RPE, translation", "cm", 3),
    ("trajectory/final/rpe_rotation_rmse_deg", "RPE, rotation", "deg", 3),
    ("trajectory/lost_frames", "frames lost", "", 0),
    ("trajectory/recognised_frames", "frames lost and recognised", "", 0),
    ("rendering/train/psnr_db", "PSNR, training views", "dB", 2),
    ("rendering/train/ssim", "SSIM", "", 4),
    ("rendering/train/ms_ssim", "MS-SSIM", "", 4),
    ("rendering/train/lpips_alex", "LPIPS (alex)", "", 3),
    ("rendering/train/depth_l1_cm", "depth L1, rendered", "cm", 3),
    ("rendering/held_out/psnr_db", "PSNR, held-out views", "dB", 2),
    ("rendering/held_out/depth_l1_cm", "depth L1, rendered, held-out views", "cm", 3),
    ("reconstruction/accuracy_cm", "mesh accuracy", "cm", 2),
    ("reconstruction/completion_cm", "mesh completion", "cm", 2),
    ("reconstruction/f_score_1cm_percent", "mesh F-score at 1 cm", "%", 1),
    ("reconstruction/f_score_5cm_percent", "mesh F-score at 5 cm", "%", 1),
    ("reconstruction/mesh_depth_l1_cm", "mesh depth L1", "cm", 2),
    ("profile/frames", "frames", "", 0),
    ("profile/frames_per_second", "frames per second", "1/s", 3),
    ("profile/tracking_ms_per_frame", "tracking per frame", "ms", 1),
    ("profile/mapping_ms_per_frame", "mapping per frame", "ms", 1),
    ("profile/viewer_drops", "frames that the viewer did not see", "", 0),
    ("profile/map_size", "map size", "primitives", 0),
    ("profile/peak_rss_mib", "peak memory", "MiB", 0),
)


def summary_table(metrics: Metrics, run_dir: Path) -> Table:
    """Return the figures that a user asks for first; n/a where one does not exist (metrics.json says why)."""
    table = Table(title=f"{run_dir}", title_justify="left", show_header=False)
    table.add_column("figure")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for key, label, unit, digits in ROWS:
        if key in metrics:
            value = metrics[key]
            text = f"{value:.{digits}f}" if isinstance(value, int | float) else "n/a"
            table.add_row(label, text, unit)
    return table
