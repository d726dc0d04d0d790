"""A simulated block of images: what each shows, by vectors between camera, ground and sun."""

import numpy as np
import pytest

from mmqa_lab.simulate.targets import ATMOSPHERES, SURFACES, Flight, blocks, fly_block
from mmqa_lab.simulate.targets.resolution import ELECTRONS_PER_DN, READ_NOISE_DN

FLIGHT = Flight(strips=3, images=4, gain_std=0.3, radial=0.2, haze=0.03)


def geometry(block):
    """Unit vectors from tie points to camera and sun, and offsets from the image's middle, m."""
    rows = block.observations.merge(block.stations, on="image", suffixes=("", "_station"))
    away = rows[["x_m", "y_m"]].to_numpy() - rows[["centre_x_m", "centre_y_m"]].to_numpy()
    camera = np.column_stack([-away, np.full(len(away), 300.0)])
    camera /= np.linalg.norm(camera, axis=1, keepdims=True)
    zenith, azimuth = (np.radians(rows[f"sun_{one}_deg"]) for one in ("zenith", "azimuth"))
    level = np.column_stack([np.sin(azimuth), np.cos(azimuth)]) * np.sin(zenith).to_numpy()[:, None]
    return rows, away, camera, np.column_stack([level, np.cos(zenith)])


def test_fly_block_shows_ground_light_and_lens_as_their_vectors_say(monkeypatch):
    monkeypatch.setattr(blocks, "WINDOW_PIXELS", 1e30)  # no noise
    block = fly_block(FLIGHT, seed=5)
    rows, away, camera, sun = geometry(block)
    zenith = np.degrees(np.arccos(camera[:, 2]))
    assert rows["view_zenith_deg"].to_numpy() == pytest.approx(zenith)
    flat = [v[:, :2] / np.linalg.norm(v[:, :2], axis=1, keepdims=True) for v in (camera, sun)]
    cosine = (flat[0] * flat[1]).sum(axis=1)
    assert np.cos(np.radians(rows["azimuth_deg"].to_numpy())) == pytest.approx(cosine)
    assert rows["azimuth_deg"].between(0, 180).all()
    radius = np.linalg.norm(away, axis=1) / np.linalg.norm([180, 120])  # 1 in the corners
    assert rows["radius"].to_numpy() == pytest.approx(radius)
    terms = SURFACES.set_index("surface").loc[rows["surface"]]
    turned = 1 + terms["b1"] * np.radians(zenith) ** 2 + terms["b2"] * np.radians(zenith) * cosine
    light = sun[:, 2] * rows["reference"].to_numpy() * turned.to_numpy() + 0.03
    seen = rows["gain"].to_numpy() * light * (1 - 0.2 * radius**2)
    assert rows["radiance"].to_numpy() == pytest.approx(seen)
    assert np.abs(away).max(axis=0) == pytest.approx([180, 120], abs=20)
    assert (np.abs(away) < [180, 120]).all()
    assert block.observations["tie"].value_counts().min() == 2


def test_every_tie_point_in_two_images_is_there():
    block = fly_block(FLIGHT, seed=5)
    centres = block.stations[["centre_x_m", "centre_y_m"]].to_numpy()
    size = centres.max(axis=0) + [180, 120]
    ground = [(x, y) for y in np.arange(10, size[1], 20) for x in np.arange(10, size[0], 20)]
    seen = [int((np.abs(place - centres) < [180, 120]).all(axis=1).sum()) for place in ground]
    found = block.observations.groupby("tie")[["x_m", "y_m"]].agg(["first", "size"])
    assert found.index.tolist() == [k for k, n in enumerate(seen) if n > 1]
    assert found["x_m", "size"].tolist() == [n for n in seen if n > 1]
    places = found[[("x_m", "first"), ("y_m", "first")]].to_numpy()
    assert places == pytest.approx(np.array([ground[k] for k in found.index]))


def test_noise_of_a_block_is_that_of_electrons_and_reading_over_its_window(monkeypatch):
    noisy = fly_block(FLIGHT, seed=5)
    monkeypatch.setattr(blocks, "WINDOW_PIXELS", 1e30)
    clean = fly_block(FLIGHT, seed=5)
    rows = geometry(clean)[0]
    dn = rows["radiance"] * 9000 * rows["exposure"]
    std = np.sqrt((dn / ELECTRONS_PER_DN + READ_NOISE_DN**2) / 25)
    off = (noisy.observations["radiance"] - clean.observations["radiance"]) * 9000
    ratio = off.to_numpy() * rows["exposure"].to_numpy() / std.to_numpy()
    assert len(ratio) > 1500
    assert ratio.std() == pytest.approx(1, abs=0.06)
    assert abs(ratio.mean()) < 0.1


def test_stations_have_exposures_gains_and_suns_as_stated(rng):
    made = blocks._stations(Flight(strips=40, images=50, gain_std=0.3), rng)
    assert made["image"].tolist() == [*range(2000)]
    assert np.log(made["gain"]).std() == pytest.approx(0.3, rel=0.06)
    assert np.log(made["gain"]).mean() == pytest.approx(0, abs=0.03)
    assert np.log(made["exposure"]).std() == pytest.approx(0.1, rel=0.06)
    assert np.log(made["exposure"]).mean() == pytest.approx(0, abs=0.01)
    assert (made["exposure"] * 20).to_numpy() == pytest.approx(np.round(made["exposure"] * 20))
    for name, ends in (("sun_zenith_deg", (40, 47)), ("sun_azimuth_deg", (150, 175))):
        step = (ends[1] - ends[0]) / 1999
        assert made[name].to_numpy() == pytest.approx(ends[0] + step * np.arange(2000))
    assert made["centre_x_m"].iloc[[0, 49, 50]].tolist() == pytest.approx([180, 180, 396])
    along = 120 + 96 * np.arange(50)
    assert made["centre_y_m"].tolist() == pytest.approx([*along, *along[::-1]] * 20)


def test_fields_have_a_surface_and_a_level_each():
    stations = blocks._stations(Flight(strips=10, images=30), np.random.default_rng(0))
    ties = blocks._ties(stations, np.random.default_rng(1), fields=500)
    base = SURFACES.set_index("surface").loc[ties["surface"]]
    assert ties["b1"].to_numpy() == pytest.approx(base["b1"].to_numpy())
    assert ties["b2"].to_numpy() == pytest.approx(base["b2"].to_numpy())
    ratio = np.log(ties["reference"].to_numpy() / base["reflectance"].to_numpy())
    assert ratio.std() == pytest.approx(np.hypot(0.15, 0.045), rel=0.08)
    assert ratio.mean() == pytest.approx(0, abs=0.03)
    shares = ties["surface"].value_counts(normalize=True)
    assert shares.to_numpy() == pytest.approx(0.2, abs=0.06)
    grid = ties["surface"].to_numpy().reshape(-1, len(ties["x_m"].unique()))
    same = ratio.reshape(grid.shape)
    alike = (grid[:, 1:] == grid[:, :-1]) & (np.abs(np.diff(same, axis=1)) < 0.3)
    assert 0.6 < alike.mean() < 0.95  # neighbours mostly share their field
    # of one field the levels differ by details alone
    inner = np.diff(same, axis=1)[alike]
    assert np.median(np.abs(inner)) == pytest.approx(0.6745 * 0.045 * 2**0.5, rel=0.1)


def test_radiance_at_the_camera_is_equation_1():
    air = ATMOSPHERES["hazy"]
    rho = np.array([0.0, 0.1, 0.5])
    ground = 950 / (1 - 0.2 * 0.3) / np.pi  # of a series of reflections between ground and air
    found = air.radiance(rho, surroundings=0.3)
    assert found == pytest.approx(38 + ground * (0.62 * rho + 0.15 * 0.3))
    many = air.radiance(np.full(20_000, 0.1), surroundings=0.3, seed=3) - found[1]
    assert many.std() == pytest.approx(38 * 0.005, rel=0.02)
    assert abs(many.mean()) < 0.01
    usual = air.radiance(0.1)
    assert usual == pytest.approx(air.radiance(0.1, surroundings=0.15))
