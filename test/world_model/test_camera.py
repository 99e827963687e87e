"""What a camera with any detector says about the world, and that what it does not report counts as far as it should."""

from __future__ import annotations

import io
import struct
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from depth_camera import DepthCamera, looking
from PIL import Image

from estimation.errors import InputError
from whereabouts.recorded.camera_messages import Cameras, camera_from_message, check_depth, depth_from_message
from whereabouts.simulation.home.apartment_camera import Item
from whereabouts.simulation.home.floor_plan import apartment
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldState
from world_model.camera import (
    CameraModel,
    CameraView,
    DepthImage,
    ImageBox,
    LevelScan,
    SightRates,
    located,
    located_by_scan,
)

UNKNOWN = np.array([np.nan])
K = (500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0)
FORWARD = looking(np.array([0.0, 0.0, 1.0]), np.array([2.0, 0.0, 1.0]))
CUP = Item("cup", "red", (0.05, 0.05, 0.06))
BOWL = Item("bowl", "green", (0.09, 0.09, 0.05))
ON_TABLE, BESIDE = np.array([0.0, 3.5, 0.76]), np.array([0.4, 3.8, 0.75])
NOBODY = np.zeros((0, 6))
SOMEBODY = np.array([[-0.4, 2.2, 0.0, 0.8, 2.6, 1.75]])


def lens(d: tuple[float, ...] = (), model: str = "plumb_bob") -> CameraModel:
    return CameraModel.checked((640, 480), K, d, model)


def test_distortion_is_that_of_the_printed_formula() -> None:
    k1, k2, p1, p2, k3, k4, k5, k6 = 0.12, -0.3, 0.002, -0.001, 0.05, 0.08, -0.1, 0.01
    x, y = 0.31, -0.22
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = 500.0 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)) + 320.0
    v = 510.0 * (y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y) + 240.0
    camera = lens((k1, k2, p1, p2, k3, k4, k5, k6), "rational_polynomial")
    assert camera.project([[2.0 * x, 2.0 * y, 2.0]])[0] == pytest.approx([u, v])
    plain = lens((k1, k2, p1, p2, k3))
    bent = 500.0 * (x * (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) + 2 * p1 * x * y + p2 * (r2 + 2 * x**2))
    assert plain.project([[x, y, 1.0]])[0, 0] == pytest.approx(bent + 320.0)


@pytest.mark.parametrize(
    ("d", "model"),
    [
        ((), ""),
        ((-0.28, 0.07, 1e-3, -5e-4, 0.0), "plumb_bob"),
        ((0.1, -0.2, 1e-3, 1e-3, 0.05, 0.05, -0.05, 0.01), "rational_polynomial"),
    ],
)
def test_rays_lead_back_to_their_pixels(d: tuple[float, ...], model: str) -> None:
    camera = lens(d, model)
    x, y = np.meshgrid(np.linspace(5, 634, 9), np.linspace(5, 474, 7))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    assert camera.project(3.0 * camera.rays(pixels)) == pytest.approx(pixels, abs=1e-3)


def test_pixels_and_points_of_another_shape_are_refused() -> None:
    for call, named in (
        (lambda: lens().rays(np.zeros((4, 3))), "pixels"),
        (lambda: lens().project(np.zeros((3, 2))), "points"),
        (lambda: CameraModel.checked((640, np.nan), np.eye(3)), "size"),
        (lambda: CameraModel.checked((640, 480), "lens"), "k"),
    ):
        with pytest.raises(InputError, match=named):
            call()


def test_what_is_far_beside_the_view_is_not_folded_back_into_it() -> None:
    camera = lens((-0.3, 0.0, 0.0, 0.0, 0.0))
    beside = np.array([[np.tan(angle), 0.0, 1.0] for angle in (1.0, 1.2, 1.4)] + [[0.0, 0.0, -1.0]])
    assert not camera.inside(camera.project(beside)).any()


def test_rectified_images_use_the_projection_alone_and_raw_ones_are_turned() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    info = SimpleNamespace(
        width=640, height=480, k=K, d=[0.1, 0.0, 0.0, 0.0, 0.0], distortion_model="plumb_bob", r=turn.ravel(),
        p=(400.0, 0.0, 300.0, 0.0, 0.0, 400.0, 200.0, 0.0, 0.0, 0.0, 1.0, 0.0), binning_x=0, binning_y=0,
        roi=SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0),
    )  # fmt: skip
    flat = camera_from_message(info, rectified=True)
    assert flat.project([[0.1, 0.2, 1.0]])[0] == pytest.approx([340.0, 280.0])
    raw = camera_from_message(info, rectified=False)
    # R leads to the straightened frame: its inverse takes x to -y here.
    assert raw.project([[0.1, 0.0, 1.0]])[0] == pytest.approx([320.0, 240.0 - 510.0 * 0.1 * 1.001])
    info.binning_x = info.binning_y = 2
    info.roi = SimpleNamespace(x_offset=40, y_offset=20, width=400, height=300)
    part = camera_from_message(info, rectified=True)
    assert (part.width, part.height) == (200, 150)
    # The middle of a pixel of two is between the middles of these.
    assert part.project([[0.1, 0.2, 1.0]])[0] == pytest.approx([(340 - 40 - 0.5) / 2, (280 - 20 - 0.5) / 2])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"size": (0, 480)}, "width and height"),
        ({"k": (0.0,) * 9}, "calibrated"),
        ({"k": (np.nan,) * 9}, "nine finite numbers"),
        ({"k": (500.0, 0, 9e4, 0, 500, 240, 0, 0, 1)}, "centre"),
        ({"d": (0.1, 0.2), "model": "equidistant"}, "'equidistant'"),
        ({"d": (0.1, 0.2), "model": "plumb_bob"}, "d: 5"),
        ({"r": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)}, "rotation"),
    ],
)
def test_wrong_lenses_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        CameraModel.checked(**{"size": (640, 480), "k": K, **changes})  # type: ignore[arg-type]


def test_depth_is_read_in_metres_and_what_is_unknown_stays_so() -> None:
    millimetres = np.array([[1500, 0, 65535], [1, 2, 3]], np.uint16)
    padded = np.zeros((2, 8), np.uint8)
    padded[:, :6] = millimetres.view(np.uint8).reshape(2, 6)
    image = DepthImage.decoded((3, 2), "16UC1", padded.tobytes(), step=8)
    assert image.metres[0] == pytest.approx([1.5, np.nan, 65.535], nan_ok=True)
    swapped = DepthImage.decoded((3, 2), "16UC1", millimetres.byteswap().tobytes(), big_endian=True)
    assert np.array_equal(swapped.metres, image.metres, equal_nan=True)
    metres = np.array([[1.5, np.nan, np.inf, 0.0, -1.0]], np.float32)
    floats = DepthImage.decoded((5, 1), "32FC1", metres.tobytes())
    assert floats.metres[0] == pytest.approx([1.5] + 4 * [np.nan], nan_ok=True)
    assert np.isnan(image.at(np.array([[-1.0, 0.0], [3.0, 0.0], [np.nan, 0.0], [1.0, 0.0]]))).all()


@pytest.mark.parametrize(
    ("size", "encoding", "count", "step", "words"),
    [
        ((4, 2), "rgb8", 24, 12, "encoding: .*'rgb8'"),
        ((4, 2), "16UC1", 15, 8, "data: 16 bytes"),
        ((4, 2), "32FC1", 64, 8, "step: at least 16"),
        ((0, 2), "32FC1", 64, 0, "step"),
    ],
)
def test_wrong_depth_images_are_refused(
    size: tuple[int, int], encoding: str, count: int, step: int, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        DepthImage.decoded(size, encoding, bytes(count), step)


def test_a_depth_image_in_another_unit_is_refused_and_one_without_depths_is_not() -> None:
    millimetres = np.array([[0.0, 1500.0, 700.0]], np.float32)
    with pytest.raises(InputError, match="units of 1 m expected, the nearest depth is 700 m"):
        DepthImage.decoded((3, 1), "32FC1", millimetres.tobytes())
    assert np.isnan(DepthImage.decoded((3, 1), "32FC1", bytes(12)).metres).all()


def test_a_box_is_placed_at_its_object_not_at_the_wall_behind() -> None:
    camera = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
    metres = np.full((120, 160), 4.0, np.float32)
    metres[50:70, 90:110] = 2.0
    metres[55:58, 95:98] = np.nan
    found = located(ImageBox(99.5, 59.5, 24.0, 24.0), camera, DepthImage(metres))
    # As deep as it is wide: its middle is half of that behind its front.
    assert found.position[2] == pytest.approx(2.0 + 0.5 * 24.0 * 2.0 / 140.0, abs=0.02)
    assert found.position[0] == pytest.approx(found.position[2] * 20.0 / 140.0)
    assert (found.width, found.height) == pytest.approx((0.343, 0.343), abs=0.01)
    assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()
    # A depth between front and background is nobody's.
    stripes = np.where(np.arange(160) % 10 < 3, 1.0, 9.0).astype(np.float32) * np.ones((120, 1), np.float32)
    assert located(ImageBox(80.0, 60.0, 40.0, 40.0), camera, DepthImage(stripes)).position[2] < 2.0
    cut = located(ImageBox(4.0, 59.5, 20.0, 24.0), camera, DepthImage(metres))
    assert (cut.width, cut.height) == (0.0, 0.0)
    for box, words in (
        (ImageBox(300.0, 60.0, 10.0, 10.0), "resized"),
        (ImageBox(80.0, 60.0, 0.0, 10.0), "sides of at least a pixel"),
        (ImageBox(0.5, 0.5, 0.1, 0.2), "sides of at least a pixel"),
        (ImageBox(np.nan, 60.0, 5.0, 10.0), "finite middle"),
        (ImageBox(96.0, 56.0, 2.0, 2.0), "no depth"),
    ):
        with pytest.raises(InputError, match=words):
            located(box, camera, DepthImage(metres))


def test_a_scan_places_boxes_and_hides_what_is_behind_walls_but_not_what_stands_on_furniture() -> None:
    camera = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
    y = np.linspace(-2.0, 2.0, 400)
    wall = np.column_stack([np.full(400, 3.0), y, np.full(400, 0.2)])
    scan = LevelScan(wall, FORWARD[:3, 3])
    view = CameraView(camera, FORWARD, scan=scan)
    found = located_by_scan(ImageBox(79.5, 59.5, 10.0, 10.0), camera, FORWARD, scan)
    assert (FORWARD[:3, :3] @ found.position + FORWARD[:3, 3])[:2] == pytest.approx([3.1, 0.0], abs=0.05)
    places = np.array([[2.0, 0.0, 1.0], [3.2, 0.0, 1.0], [4.5, 0.0, 1.0]])
    clear = view.visible(places, np.full(3, 0.02), np.full(3, np.nan))
    assert clear == pytest.approx([1.0, 1.0, 0.0])
    with pytest.raises(InputError, match="meets nothing"):
        located_by_scan(ImageBox(79.5, 59.5, 10.0, 10.0), camera, FORWARD, LevelScan(-wall, FORWARD[:3, 3]))


def test_in_view_hidden_unknown_beside_and_behind() -> None:
    camera = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
    metres = np.full((120, 160), 5.0, np.float32)
    metres[:, 100:] = 1.0  # something near on the right
    metres[:, :40] = np.nan  # a hole on the left
    view = CameraView(camera, FORWARD, DepthImage(metres))
    places = np.array([[3, 0, 1], [3, -1, 1], [3, 1.4, 1], [3, 4, 1], [-3, 0, 1], [6, 0, 1]], dtype=float)
    clear = view.visible(places, np.full(6, 0.02), np.full(6, np.nan))
    assert clear == pytest.approx([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    # A detection that nobody could place may be of what is there.
    taken = CameraView(camera, FORWARD, DepthImage(metres), taken=(ImageBox(79.5, 59.5, 30.0, 30.0),))
    assert taken.visible(places[:1], np.array([0.02]), UNKNOWN) == [0.0]
    # Nobody knows what was in view where nobody knows where the robot is.
    lost = CameraView(
        camera, FORWARD, DepthImage(metres), pose_covariance=np.diag([0.5, 0.5, 0.1]), origin=np.zeros(2)
    )
    assert lost.visible(places[:1], np.array([0.02]), UNKNOWN)[0] < 0.3
    # Without depth nothing is known to be hidden.
    assert CameraView(camera, FORWARD).visible(places, np.full(6, 0.02), np.full(6, np.nan)) == pytest.approx(
        [1.0, 1.0, 1.0, 0.0, 0.0, 1.0]
    )
    sizes = view.recognisable(np.array([[3.0, 0, 1], [12.0, 0, 1]]), np.array([0.8, 0.1]))
    assert sizes[0] > 0.9
    assert sizes[1] < 0.1


@pytest.mark.parametrize("down", [0.0, 0.4, 1.2, 1.5])
def test_the_cone_of_a_view_holds_all_of_it(down: float) -> None:
    camera = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
    ahead = np.array([np.cos(down), 0.3, -np.sin(down)])
    view = CameraView(camera, looking(np.array([1.0, 2.0, 1.5]), np.array([1.0, 2.0, 1.5]) + ahead))
    rng = np.random.default_rng(3)
    rays = camera.rays(rng.uniform(0, (160, 120), (500, 2)))
    points = view.pose[:3, 3] + 2.0 * rays @ view.pose[:3, :3].T
    x, y, _, yaw = view.sensor["pose"]
    off = np.arctan2(points[:, 1] - y, points[:, 0] - x) - yaw
    assert np.abs(np.arctan2(np.sin(off), np.cos(off))).max() <= 0.5 * view.sensor["angle"] + 1e-9


def test_images_belong_to_detections_by_stamp_and_frame() -> None:
    cameras = Cameras(tolerance=50)
    info = SimpleNamespace(
        width=4, height=2, k=(4.0, 0, 2, 0, 4, 1, 0, 0, 1), d=[], distortion_model="", r=(), p=(),
        binning_x=0, binning_y=0, roi=SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0),
    )  # fmt: skip
    with pytest.raises(InputError, match="no camera_info of 'eye'"):
        cameras.lens_for("eye", of_image=True)
    assert cameras.lens_for("base_link", of_image=False) is None
    cameras.take_info(info, "eye")
    with pytest.raises(InputError, match=r"image of 'nose'.*'eye'"):
        cameras.lens_for("nose", of_image=True)
    found = cameras.lens_for("base_link", of_image=False)
    assert found is not None
    assert found[0] == "eye"
    for stamp in (100, 140):
        cameras.keep(stamp, f"image at {stamp}")
    assert cameras.nearest(120) == (100, "image at 100")
    assert cameras.nearest(121) == (140, "image at 140")
    assert cameras.nearest(191) is None
    message = SimpleNamespace(width=4, height=2, encoding="16UC1", data=bytes(16), step=8, is_bigendian=0)
    depth = depth_from_message(message)
    check_depth(depth, "eye", found[1], "eye")
    with pytest.raises(InputError, match="register it"):
        check_depth(depth, "depth_eye", found[1], "eye")
    with pytest.raises(InputError, match="4 x 2 pixels, camera_info tells of 640 x 480"):
        check_depth(depth, "eye", lens(), "eye")


def packed(pixels: np.ndarray, encoding: str, head: bytes) -> SimpleNamespace:
    png = io.BytesIO()
    Image.fromarray(pixels).save(png, "PNG")
    return SimpleNamespace(format=f"{encoding}; compressedDepth png", data=head + png.getvalue())


def rolled(pixels: np.ndarray, encoding: str, head: bytes) -> SimpleNamespace:
    """As RVL writes it (Wilson 2017), number by number."""
    nibbles: list[int] = []

    def write(number: int) -> None:
        while True:
            nibbles.append(number & 7 | (8 if number > 7 else 0))
            number >>= 3
            if not number:
                return

    flat, at, before = pixels.ravel().astype(int).tolist(), 0, 0
    while at < len(flat):
        first = next((k for k in range(at, len(flat)) if flat[k]), len(flat))
        last = next((k for k in range(first, len(flat)) if not flat[k]), len(flat))
        write(first - at)
        write(last - first)
        for depth in flat[first:last]:
            step, before = depth - before, depth
            write(2 * step if step >= 0 else -2 * step - 1)
        at = last
    nibbles += [0] * (-len(nibbles) % 8)
    words = [
        sum(each << (28 - 4 * k) for k, each in enumerate(nibbles[n : n + 8]))
        for n in range(0, len(nibbles), 8)
    ]
    data = struct.pack(f"<II{len(words)}I", *pixels.shape[::-1], *words)
    return SimpleNamespace(format=f"{encoding}; compressedDepth rvl", data=head + data)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_depth_images_of_rvl_are_those_that_were_packed_and_damage_is_refused(share: float) -> None:
    rng = np.random.default_rng(4)
    pixels = np.where(rng.random((13, 17)) < share, rng.integers(1, 65536, (13, 17)), 0).astype(np.uint16)
    message = rolled(pixels, "16UC1", bytes(12))
    wanted = np.where(pixels > 0, 1e-3 * pixels.astype(float), np.nan)
    np.testing.assert_allclose(depth_from_message(message).metres, wanted, rtol=1e-6)
    for cut in (0, 11, 19, 20, len(message.data) - 4):
        with pytest.raises(InputError, match=r"data: .*RVL"):
            depth_from_message(SimpleNamespace(format=message.format, data=message.data[:cut]))
    for _ in range(200):
        damaged = bytearray(message.data)
        damaged[rng.integers(12, len(damaged))] ^= 1 << rng.integers(8)
        with suppress(InputError):
            depth_from_message(SimpleNamespace(format=message.format, data=bytes(damaged)))


def test_compressed_depth_images_are_those_that_were_compressed() -> None:
    millimetres = np.array([[0, 800, 65535], [1234, 1, 40000]], np.uint16)
    wanted = np.where(millimetres > 0, 1e-3 * millimetres, np.nan)
    for head in (bytes(12), b""):
        depth = depth_from_message(packed(millimetres, "16UC1", head))
        assert depth.size == (3, 2)
        np.testing.assert_allclose(depth.metres, wanted, rtol=1e-6)
    # In m, as compressed_depth_image_transport makes whole numbers of them: a depth and its inverse.
    a, b = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0
    metres = np.array([[0.7, 2.5, 9.0]])
    whole = np.round(a / metres + b).astype(np.uint16)
    for pack in (packed, rolled):
        depth = depth_from_message(pack(whole, "32FC1", struct.pack("<iff", 0, a, b)))
        np.testing.assert_allclose(depth.metres, metres, rtol=0.01)


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (packed(np.zeros((2, 2), np.uint16), "rgb8", b""), "format: that of a depth image"),
        (SimpleNamespace(format="16UC1; compressedDepth rvl", data=bytes(40)), "data: RVL of 0 x 0 pixels"),
        (SimpleNamespace(format="16UC1; compressedDepth rvl", data=b"\xff" * 40), "data: RVL of .* pixels"),
        (SimpleNamespace(format="16UC1; compressedDepth", data=b""), "data: a PNG or RVL expected"),
        (SimpleNamespace(format="16UC1; png", data=b"\x89PNG cut off"), "data: the PNG cannot be read"),
        (packed(np.zeros((2, 2), np.uint8), "16UC1", b""), "data: one channel of 16 bits"),
        (packed(np.zeros((2, 2), np.uint16), "32FC1", b""), "no PNG but by compressedDepth"),
    ],
)
def test_what_is_no_compressed_depth_image_is_refused(message: SimpleNamespace, said: str) -> None:
    with pytest.raises(InputError, match=said):
        depth_from_message(message)


class Kitchen:
    """A robot before the kitchen table: a rendered depth image, a detector that errs, and the world made of both."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.camera = DepthCamera()
        self.home = apartment()
        self.rates = SightRates()
        self.pose = looking(np.array([0.1, 1.8, 1.25]), np.array([0.2, 3.6, 0.7]))
        self.model = WorldModel(
            WorldModelConfig(
                classes=["cup", "bowl", "book"],
                region=((-2.0, 9.0), (-6.0, 6.0), (-0.5, 2.5)),
                clutter_per_frame=0.05,
            )
        )
        self.now = 0.0

    def look(
        self, things: dict[str, tuple[Item, np.ndarray]], count: int, more: np.ndarray = NOBODY
    ) -> WorldState:
        scene = self.camera.scene(self.pose, np.vstack([self.home.blocks, more]), things)
        for _ in range(count):
            depth = scene.depth(self.rng)
            image = DepthImage.decoded((160, 120), "32FC1", depth.astype("<f4").tobytes())
            objects = []
            for found in scene.detections(self.rng):
                placed = located(found.box, self.camera.camera, image)
                turn = self.pose[:3, :3]
                rest = {kind: 0.05 for kind in ("cup", "bowl", "book") if kind not in found.scores}
                objects.append(
                    ObjectEvidence(
                        turn @ placed.position + self.pose[:3, 3],
                        turn @ placed.covariance @ turn.T,
                        {"class": {**found.scores, **rest}},
                    )
                )
            view = CameraView(self.camera.camera, self.pose, image, rates=self.rates)
            state = self.model.update(WorldEvidence(objects, view=view), self.now)
            self.now += 0.2
        return state


def near(state: WorldState, place: np.ndarray) -> bool:
    return any(not o.lost and np.linalg.norm(o.position - place) < 0.1 for o in state.objects)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_carried_away_is_gone_and_what_is_hidden_or_out_of_view_stays(seed: int) -> None:
    kitchen = Kitchen(seed)
    both = {"cup": (CUP, ON_TABLE), "bowl": (BOWL, BESIDE)}
    state = kitchen.look(both, 30)
    assert near(state, ON_TABLE)
    assert near(state, BESIDE)
    # Somebody stands before the table: nothing is reported for eight seconds, and nothing follows from it.
    state = kitchen.look(both, 40, SOMEBODY)
    assert near(state, ON_TABLE)
    assert near(state, BESIDE)
    ahead = kitchen.pose
    kitchen.pose = looking(np.array([0.1, 1.8, 1.25]), np.array([3.0, 0.0, 0.7]))
    state = kitchen.look({}, 40)
    assert near(state, ON_TABLE)
    assert near(state, BESIDE)
    kitchen.pose = ahead
    state = kitchen.look({"bowl": (BOWL, BESIDE)}, 8)
    assert not near(state, ON_TABLE)
    assert near(state, BESIDE)


def test_how_good_the_detector_is_is_learned_while_driving() -> None:
    kitchen = Kitchen(5)
    both = {"cup": (CUP, ON_TABLE), "bowl": (BOWL, BESIDE)}
    kitchen.look(both, 150)
    total = kitchen.rates.found + kitchen.rates.missed
    share = kitchen.rates.found.sum() / total.sum()
    assert total.sum() > 200
    assert share == pytest.approx(kitchen.camera.detected, abs=0.06)
    figures = kitchen.rates.figures()
    assert float(figures["named right"].split()[0]) == pytest.approx(kitchen.camera.accuracy, abs=0.06)
    # What it was never seen to find at some size stays as assumed.
    assert SightRates(16.0).recognisable(np.array([16.0]))[0] == pytest.approx(0.5)
    # What is carried away was not missed.
    before = kitchen.rates.missed.sum()
    kitchen.look({"bowl": (BOWL, BESIDE)}, 12)
    kitchen.look({}, 12)
    assert kitchen.rates.missed.sum() - before < 6


def test_a_camera_says_nothing_of_classes_that_its_detector_does_not_know_and_others_find(
    tmp_path: Path,
) -> None:
    rates, rng = SightRates(), np.random.default_rng(3)
    model = WorldModel(
        WorldModelConfig(classes=["cup", "bowl"], region=((-1.0, 6.0), (-3.0, 3.0), (-0.5, 2.5)))
    )
    things, knows = {"cup": (2.0, 0.3, 1.0), "bowl": (2.2, -0.3, 1.0)}, {"left": "cup", "right": "bowl"}
    here = []
    for step in range(240):
        camera = ("left", "right")[step // 16 % 2]
        kind = knows[camera]
        spot = np.array(things[kind]) + rng.normal(0.0, 0.01, 3)
        seen = [
            ObjectEvidence(spot, 1e-4 * np.eye(3), {"class": {kind: 0.9, ({*things} - {kind}).pop(): 0.1}})
        ]
        view = CameraView(lens(), FORWARD, rates=rates, name=camera)
        state = model.update(WorldEvidence(seen, view=view), 0.25 * step)
        here.append({item.most_probable("class") for item in state.objects})
    assert all(found == {"cup", "bowl"} for found in here[120:])
    assert rates.reported("left", ["cup", "bowl"]) == pytest.approx([1.0, 0.0], abs=0.1)
    assert rates.missed.sum() == 0.0
    rates.write(tmp_path / "kept")
    again = SightRates()
    again.read(tmp_path / "kept")
    assert again.figures() == rates.figures()
    assert again.figures()["classes that right does not know"] == "cup"


def test_what_was_learned_of_the_detector_is_kept_and_damage_is_told(tmp_path: Path) -> None:
    rates = SightRates()
    rates.found[3], rates.missed[3], rates.looks = 90.0, 10.0, 120
    rates.named[("cup", "bowl")] = 7
    rates.named[("cup", "cup")] = 93
    kept = tmp_path / "home.sqlite.camera"
    rates.write(kept)
    again = SightRates()
    again.read(kept)
    assert again.figures() == rates.figures() != {}
    pixels = np.array([8.0, 40.0, 300.0])
    assert again.recognisable(pixels) == pytest.approx(rates.recognisable(pixels))
    text = kept.read_text()
    for spoilt in (text.replace("90.0", "91.0"), text[:40], "", text.replace("camera rates", "else")):
        kept.write_text(spoilt)
        fresh = SightRates()
        with pytest.raises(InputError):
            fresh.read(kept)
        assert fresh.figures() == {}


def test_a_false_detection_lies_somewhere_in_the_picture_on_what_is_seen() -> None:
    rng = np.random.default_rng(0)
    wall, sigma = 4.0, 0.2
    camera = lens()
    view = CameraView(camera, np.eye(4), DepthImage(np.full((480, 640), wall, np.float32)))
    # The integral over the wall and its blur, by drawing points of a block around it.
    block = np.array([640 / 500.0, 480 / 510.0, 1.0]) * wall
    points = rng.uniform(-0.5, 0.5, (200_000, 3)) * block + (0.0, 0.0, wall)
    blur = np.exp(-0.5 * ((points[:, 2] - wall) / sigma) ** 2)
    points[:, 2] = wall
    density = view.density(points, np.tile(sigma**2 * np.eye(3), (len(points), 1, 1)))
    assert density is not None
    assert float((density * blur).mean() * block.prod()) == pytest.approx(1.0, rel=0.03)
    assert CameraView(camera, np.eye(4)).density(points[:1], sigma**2 * np.eye(3)[None]) is None


def test_a_camera_of_large_things_has_seen_far_places_empty() -> None:
    shares = [
        CameraView(lens(), np.eye(4), DepthImage(np.full((480, 640), 60.0, np.float32))).cells(
            np.array([[0.0, 0.0]]), np.array([25.0]), size
        )[0]
        for size in (0.1, 2.0)
    ]
    assert shares[0] < 0.1 < 0.9 < shares[1]
