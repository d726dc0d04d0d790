"""The figures of the image-radiometry study."""

import numpy as np

from mmqa_lab.mtf.edge import fit_edge
from mmqa_lab.plots import COLOURS, DIVERGING_MAP, MAP, subplots
from mmqa_lab.radiometry.brdf import WalthallFit
from mmqa_lab.simulate.targets import PointSpread, render_edge

METHOD_COLOURS = {
    "sigmoid: Gaussian": COLOURS["blue"],
    "sigmoid: logistic": COLOURS["vermilion"],
    "edge method": COLOURS["green"],
}


def draw_edge(image, spread, angle_deg, *, ax):
    """Draw an edge's pixels over their distance, with both sigmoids and their line spreads."""
    fits = {name: fit_edge(image, shape=name) for name in ("gaussian", "logistic")}
    best = fits["gaussian"]
    rows, columns = np.indices(image.shape)
    turn = np.radians(best.angle_deg)
    middle = (np.array(image.shape) - 1) / 2
    across = (columns - middle[1]) * np.cos(turn) + (rows - middle[0]) * np.sin(turn)
    place = (across - best.position_px).ravel()
    level = (image.ravel() - best.low) / (best.high - best.low)
    near = np.abs(place) < 3
    ax.plot(place[near], level[near], ".", ms=1, color=COLOURS["grey"], alpha=0.4)
    x = np.linspace(-3, 3, 401)
    for (name, fit), dash in zip(fits.items(), ("-", "--"), strict=True):
        colour = METHOD_COLOURS["sigmoid: Gaussian" if name == "gaussian" else "sigmoid: logistic"]
        label = f"{name}: FWHM {fit.fwhm_px:.2f} px"
        ax.plot(x, fit.esf(x), dash, color=colour)
        ax.plot(x, fit.lsf(x), dash, color=colour, label=label)
    ax.annotate(f"true FWHM {spread.fwhm(angle_deg):.2f} px", (-2.9, 0.92), fontsize=7)
    ax.set(xlabel="distance across the edge (px)", ylabel="edge and line spread (1, 1/px)")
    ax.set(xlim=(-3, 3), ylim=(-0.05, 1.05))
    ax.legend(loc="upper left", bbox_to_anchor=(-0.12, 1.2), ncols=2, columnspacing=0.8)
    return ax


def draw_edge_errors(edges, *, ax, name="fwhm"):
    """Draw the errors of FWHM or MTF50 over the blur, by method."""
    column = f"{name}_error_percent"
    shown = edges.dropna(subset=[column])
    for shift, (method, rows) in enumerate(shown.groupby("method", sort=False)):
        groups = rows.groupby("sigma_px")[column]
        place = np.array(list(groups.groups)) * (1 + 0.02 * shift)
        low, middle, high = (groups.quantile(q).to_numpy() for q in (0.05, 0.5, 0.95))
        bars = {"fmt": "o", "ms": 3, "capsize": 2, "color": METHOD_COLOURS[method]}
        ax.errorbar(place, middle, yerr=[middle - low, high - middle], label=method, **bars)
    ax.axhspan(-1, 1, color=COLOURS["sky"], alpha=0.3)
    ax.set(xlabel="blur before the pixel, sigma (px)", xscale="log")
    ax.set(ylabel=f"{name.upper()} error (%)")
    ax.set_xticks([0.35, 0.5, 0.7, 1, 1.5, 2], ["0.35", "0.5", "0.7", "1", "1.5", "2"])
    ax.minorticks_off()
    ax.legend(loc="upper left", bbox_to_anchor=(-0.15, 1.22), ncols=3, columnspacing=0.6)
    return ax


def draw_star_image(image, star, *, ax):
    """Draw a star with the circles at which its contrast is 0.5 and 0.1."""
    ax.imshow(image, cmap="gray")
    turn = np.linspace(0, 2 * np.pi, 200)
    cycles = 2 * np.pi * star.radius_px[0] * star.frequency[0]
    for share, colour in ((0.5, "orange"), (0.1, "vermilion")):
        radius = cycles / (2 * np.pi * star.at(share))
        x, y = star.centre[0] + radius * np.cos(turn), star.centre[1] + radius * np.sin(turn)
        ax.plot(x, y, color=COLOURS[colour], lw=1, label=f"contrast {share}")
    ax.set(xlabel="column (px)", ylabel="row (px)")
    ax.legend(loc="upper left", bbox_to_anchor=(-0.1, 1.16), ncols=2)
    return ax


def draw_star_mtf(star, spread, *, ax):
    """Draw a star's contrast over frequency beside the known transfer function."""
    f = np.linspace(0, 0.5, 201)
    ax.plot(f, spread.mtf_mean(f), color=COLOURS["black"], lw=0.8, label="known")
    ax.plot(star.frequency, star.mtf, ".", ms=3, color=COLOURS["blue"], label="measured")
    ax.axvline(0.45, ls=":", lw=0.8, color=COLOURS["grey"])
    ax.annotate("0.9 Nyquist", (0.44, 0.93), fontsize=7, ha="right", color=COLOURS["grey"])
    ax.set(xlabel="frequency (cycles/px)", ylabel="contrast (MTF)", xlim=(0, 0.5), ylim=(0, 1.02))
    ax.legend(loc="lower left")
    return ax


def draw_psf(star, spread, *, ax):
    """Draw a star's point spread function beside the blur it was rendered with."""
    x = np.linspace(-3, 3, 301)
    ax.plot(x, star.psf(np.abs(x)), color=COLOURS["blue"], label=f"FWHM {star.fwhm_px:.2f} px")
    half = spread.fwhm(0.0) / 2
    ax.plot([-half, half], [0.5, 0.5], color=COLOURS["black"], label=f"known {2 * half:.2f} px")
    ax.set(xlabel="distance (px)", ylabel="point spread (peak 1)", xlim=(-3, 3), ylim=(-0.02, 1.02))
    ax.legend(loc="upper left", bbox_to_anchor=(-0.1, 1.26))
    return ax


def draw_bars(readings, images, *, axes):
    """Draw the ladder of bars, and whether each group counts as resolved."""
    for ax, image, row in zip(axes, images, readings.itertuples(), strict=False):
        ax.imshow(image, cmap="gray", vmin=0.05, vmax=0.65)
        colour = COLOURS["green"] if row.resolved else COLOURS["vermilion"]
        ax.set_title(f"{row.period_px:.1f}", color=colour, fontsize=7, pad=2)
        ax.set(xticks=[], yticks=[])
        for side in ax.spines.values():
            side.set(visible=True, color=colour, lw=1.2)
    return axes


def draw_dependence(edges, *, ax):
    """Draw the FWHM of edges over the radius, along it and across it, without the motion's."""
    radius = np.hypot(edges["x_px"], edges["y_px"])
    along = np.cos(np.radians(edges["angle_deg"]) - np.arctan2(edges["y_px"], edges["x_px"])) ** 2
    dots = ax.scatter(radius, edges["fwhm_px"], c=along, s=12, cmap=MAP)
    ax.figure.colorbar(dots, ax=ax, label="share of the radial direction")
    ax.set(xlabel="distance from the image's centre (px)", ylabel="FWHM (px)")
    return ax


def draw_sharpness(mean, *, ax):
    """Draw a map of sharpness over the image."""
    step = float(mean["x_px"][1] - mean["x_px"][0])
    x, y = mean["x_px"].to_numpy(), mean["y_px"].to_numpy()
    extent = (x[0] - step / 2, x[-1] + step / 2, y[-1] + step / 2, y[0] - step / 2)
    picture = ax.imshow(mean["sharpness"], extent=extent, cmap=MAP)
    ax.figure.colorbar(picture, ax=ax, label="sharpness (Haar, relative)", shrink=0.85)
    ax.set(xlabel="column (px)", ylabel="row (px)")
    return ax


def draw_calibration(radiance, dn, fit, *, ax, full_scale):
    """Draw digital numbers over radiance with the line, and the saturated targets."""
    used = np.isfinite(fit.residuals)
    ax.plot(radiance[used], dn[used], "o", ms=4, color=COLOURS["blue"], label="used")
    ax.plot(radiance[~used], dn[~used], "s", ms=4, color=COLOURS["vermilion"], label="saturated")
    x = np.array([0, np.max(radiance)])
    line = fit.offset + fit.gain * x
    label = f"{fit.gain:.2f} DN per unit, offset {fit.offset:.1f} DN"
    ax.plot(x, line, color=COLOURS["black"], lw=0.8, label=label)
    ax.axhline(full_scale, ls=":", lw=0.8, color=COLOURS["grey"])
    ax.set(xlabel=r"radiance (W m$^{-2}$ sr$^{-1}$ µm$^{-1}$)", ylabel="digital number")
    ax.set(ylim=(0, 1.15 * full_scale))
    ax.legend(loc="lower right")
    return ax


def draw_reflectance_errors(summary, *, ax, anisotropy="allowed for"):
    """Draw the RMSE of reflectance in percent by class and band, in clean and hazy air."""
    rows = summary[summary["anisotropy"] == anisotropy]
    names = list(dict.fromkeys(rows["target_class"]))
    bands = list(dict.fromkeys(rows["band"]))
    shades = ("green", "vermilion", "purple")
    for k, (band, colour) in enumerate(zip(bands, shades, strict=True)):
        for air, filled in (("clean", True), ("hazy", False)):
            part = rows[(rows["band"] == band) & (rows["atmosphere"] == air)]
            part = part.set_index("target_class").reindex(names)
            place = np.arange(len(names)) + 0.2 * (k - 1)
            face = COLOURS[colour] if filled else "none"
            ax.plot(
                place,
                part["rmse_percent"],
                "o",
                ms=5,
                color=COLOURS[colour],
                markerfacecolor=face,
                label=f"{band}, {air}",
            )
    for limit in (1, 5):
        ax.axhline(limit, ls=":", lw=0.8, color=COLOURS["grey"])
    ax.set(yscale="log", ylabel="RMSE of reflectance (%)")
    ax.set_xticks(np.arange(len(names)), names)
    ax.legend(loc="upper left", bbox_to_anchor=(-0.1, 1.4), ncols=2, columnspacing=0.8)
    return ax


def draw_anisotropy(adjustment, *, axes, sun_zenith=43.0, names=("grass", "forest")):
    """Draw the anisotropy factor of surfaces over all views, as the block has it.

    ``axes`` are polar: the view's zenith angle outwards, the azimuth from the sun's at the top.
    """
    azimuth = np.radians(np.linspace(0, 360, 121))
    zenith = np.linspace(0, 45, 31)
    a, v = np.meshgrid(azimuth, zenith)
    for ax, name in zip(axes, names, strict=True):
        row = adjustment.anisotropy.set_index("surface").loc[name]
        terms = np.array([row["b1"], row["b2"], 1.0])
        fit = WalthallFit(terms, np.zeros((3, 3)), "walthall", 0.0, 0)
        factor = fit.anisotropy(sun_zenith, v, np.degrees(a))
        kind = {"levels": np.arange(0.7, 1.62, 0.05), "cmap": DIVERGING_MAP, "extend": "both"}
        kind |= {"vmin": 0.4, "vmax": 1.6}  # white is 1, as at nadir
        picture = ax.contourf(a, v, factor, **kind)
        ax.plot(0, sun_zenith, "*", color=COLOURS["black"], ms=8)
        ax.set(theta_zero_location="N", title=name, yticks=[15, 30, 45])
        ax.set_xticks(np.radians([0, 90, 180, 270]), ["sun behind", "90°", "against\nsun", "270°"])
        ax.tick_params(labelsize=6, pad=0)
    axes[0].figure.colorbar(picture, ax=list(axes), label="anisotropy factor", shrink=0.8)
    return axes


def draw_mosaics(pictures, *, axes):
    """Draw mosaics of a block, each scaled to its own median, side by side."""
    for ax, (name, picture) in zip(axes, pictures.items(), strict=True):
        scaled = picture / np.nanmedian(picture)
        ax.imshow(scaled, cmap="gray", vmin=0.2, vmax=2.2, origin="lower", interpolation="nearest")
        ax.set(title=name, xticks=[], yticks=[])
    return axes


def figure_of_blur():
    """Return a function that draws an edge and its sigmoids for a blur."""

    def draw(sigma_px):
        """The edge of that blur."""
        spread = PointSpread(sigma_px)
        figure, ax = subplots(height_mm=65)
        draw_edge(render_edge((60, 60), spread, angle_deg=6.0), spread, 6.0, ax=ax)
        return figure

    return draw
