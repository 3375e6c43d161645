"""Exporters on small stand-ins with the interfaces of the published models: what they write fits the contract, and a
graph that says something else than torch is not delivered. The published weights themselves are not here."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch", reason="exporters run where torch is installed")
pytest.importorskip("onnx", reason="exporters write metadata with onnx")
if find_spec("onnxscript") is None:  # its import takes a second
    pytest.skip("torch's newer exporter needs onnxscript", allow_module_level=True)
from torch import nn  # noqa: E402

from realsim.feedforward.onnx.inspect import inspect_model  # noqa: E402
from tools.export_onnx import blockers, depth_anything_3, dust3r, map_anything, moge, pi3, vggt  # noqa: E402
from tools.export_onnx.common import ExportFailed, Family, Options, export, sample  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick_export")
DIM = 16


def options(tmp_path: Path, **changes: Any) -> Options:
    values = {
        "weights": "stand-in",
        "out": tmp_path / "m.onnx",
        "size": (28, 42),
        "views": 2,
    }
    return Options(**{**values, **changes})


def exported(module: Any, model: Any, chosen: Options) -> Any:
    """Written, compared with torch, and taken by realsim."""
    torch.manual_seed(0)
    off = export(module.wrap(model.eval(), chosen), chosen)
    assert max(off.values()) < chosen.tolerance
    found = inspect_model(chosen.out)
    assert found.fits, found.render()
    assert not found.model.warnings  # nothing is guessed
    assert [p.name for p in chosen.out.parent.iterdir()] == [chosen.out.name]
    return found


# ---------------------------------------------------------------- pieces


def turned_with_a_table(base: float, tokens: Any, positions: Any) -> Any:
    """Rotary embedding with a table as long as the largest position, as the projects write it."""
    half = tokens.shape[-1] // 2
    rate = 1 / base ** (torch.arange(0, half, 2).float() / half)
    table = torch.outer(torch.arange(int(positions.max()) + 1).float(), rate)
    table = torch.cat([table, table], -1)
    out = []
    for k, part in enumerate(tokens.chunk(2, dim=-1)):
        angle = nn.functional.embedding(positions[..., k], table)[:, None]
        a, b = part.chunk(2, dim=-1)
        out.append(part * angle.cos() + torch.cat([-b, a], -1) * angle.sin())
    return torch.cat(out, -1)


class RoPE2D(nn.Module):
    """CroCo's name and attribute."""

    def __init__(self, base: float = 100.0) -> None:
        super().__init__()
        self.base = base

    def forward(self, tokens: Any, positions: Any) -> Any:
        return turned_with_a_table(self.base, tokens, positions)


class RotaryPositionEmbedding2D(nn.Module):
    """VGGT's and Depth Anything 3's name and attribute."""

    def __init__(self, frequency: float = 100.0) -> None:
        super().__init__()
        self.base_frequency = frequency

    def forward(self, tokens: Any, positions: Any) -> Any:
        return turned_with_a_table(self.base_frequency, tokens, positions)


@pytest.mark.parametrize("embedding", [RoPE2D, RotaryPositionEmbedding2D])
def test_the_rotary_embedding_without_a_table_is_the_same(embedding: Any) -> None:
    torch.manual_seed(0)
    rope = embedding()
    holder = nn.ModuleList([rope, nn.Linear(2, 2), rope])
    tokens, positions = torch.randn(2, 3, 12, 16), blockers.grid_positions(2, 3, 4, "cpu")
    assert torch.equal(positions[0], torch.cartesian_prod(torch.arange(3), torch.arange(4)))
    before = rope(tokens, positions)
    assert blockers.replace_tables(holder) == 1
    torch.testing.assert_close(rope(tokens, positions), before)


class Positions:
    """Keeps positions by size, as the projects' own do."""

    def __init__(self) -> None:
        self.kept: dict[Any, Any] = {}

    def __call__(self, batch: int, rows: int, columns: int, device: Any) -> Any:
        if (rows, columns) not in self.kept:
            self.kept[rows, columns] = torch.cartesian_prod(torch.arange(rows), torch.arange(columns))
        return self.kept[rows, columns][None].expand(batch, -1, -1)


class Attention(nn.Module):
    """Multi-head attention over tokens (B, n, DIM), rotated by their positions (B, n, 2)."""

    def __init__(self, rope: nn.Module, heads: int = 2) -> None:
        super().__init__()
        self.rope, self.heads, self.qkv = rope, heads, nn.Linear(DIM, 3 * DIM)

    def forward(self, x: Any, pos: Any) -> Any:
        b, n, _ = x.shape
        q, k, v = self.qkv(x).reshape(b, n, 3, self.heads, DIM // self.heads).permute(2, 0, 3, 1, 4)
        x = nn.functional.scaled_dot_product_attention(self.rope(q, pos), self.rope(k, pos), v, dropout_p=0.0)
        return x.transpose(1, 2).reshape(b, n, DIM)


def test_attention_head_by_head_is_the_same_and_is_undone() -> None:
    torch.manual_seed(0)
    layer, fused = Attention(RoPE2D()), nn.functional.scaled_dot_product_attention
    x, pos = torch.randn(2, 12, DIM), blockers.grid_positions(2, 3, 4, "cpu")
    whole = layer(x, pos)
    with blockers.head_by_head(layer):
        assert nn.functional.scaled_dot_product_attention is not fused
        torch.testing.assert_close(layer(x, pos), whole)
    assert nn.functional.scaled_dot_product_attention is fused


def test_no_exported_attention_holds_all_heads_at_once(tmp_path: Path) -> None:
    import onnx

    chosen = options(tmp_path)
    export(Family(blockers.Wrapped(Attention(RoPE2D(), heads=4), _attended), ("y",), {}), chosen)
    graph = onnx.shape_inference.infer_shapes(onnx.load(chosen.out)).graph
    shapes = [[d.dim_value for d in v.type.tensor_type.shape.dim] for v in graph.value_info]
    tokens = 2 * 28 * 42 // 14**2
    squares = [s for s in shapes if s[-2:] == [tokens, tokens]]
    assert squares
    assert all(torch.tensor(s).prod() == tokens**2 for s in squares)


def _attended(layer: Any, images: Any) -> Any:
    pictures = images[0, :, :, ::14, ::14].flatten(2).transpose(1, 2).reshape(1, -1, 3)
    tokens = nn.functional.pad(pictures, (0, DIM - 3))
    return (layer(tokens, torch.zeros(1, tokens.shape[1], 2, dtype=torch.int64)),)


@pytest.mark.parametrize("affine", [True, False])
def test_group_normalisation_by_axes_is_the_same(affine: bool) -> None:
    torch.manual_seed(0)
    layer, x = nn.GroupNorm(2, 8, affine=affine), 3 + torch.randn(2, 8, 5, 7)
    before = layer(x)
    assert blockers.replace_group_norm(layer) == 1
    torch.testing.assert_close(layer(x), before)


def test_the_nearest_rotation_does_not_change_by_leaving_out_the_svd() -> None:
    """Rows of length one go out; the host's nearest rotation is that of the model's own orthogonalisation."""
    from realsim.core.geometry import nearest_rotation

    torch.manual_seed(0)
    nine = torch.randn(5, 9)
    for raw, rows in zip(nine, blockers.unit_rows(nine), strict=True):
        m = nn.functional.normalize(raw.reshape(3, 3), dim=-1).T
        u, _, vh = torch.linalg.svd(m.double())
        v = vh.T
        v = torch.cat([v[:, :2], v[:, 2:] * torch.det(v @ u.T)], 1)
        torch.testing.assert_close(
            torch.from_numpy(nearest_rotation(rows.reshape(3, 3).numpy())), v @ u.T, atol=1e-5, rtol=0
        )


# ---------------------------------------------------------------- stand-ins


class Tokens(nn.Module):
    """Pictures (B, 3, H, W) to patch tokens (B, n, DIM)."""

    def __init__(self, patch: int = 14) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, DIM, patch, patch)

    def forward(self, x: Any, is_training: bool = True) -> Any:
        return {"x_norm_patchtokens": self.conv(x).flatten(2).transpose(1, 2)}


class Head(nn.Module):
    """Patch tokens to maps (B, H, W, channels)."""

    def __init__(self, channels: int, patch: int = 14) -> None:
        super().__init__()
        self.patch, self.linear = patch, nn.Linear(DIM, channels * patch**2)

    def forward(self, tokens: Any, size: Any) -> Any:
        h, w = size
        x = self.linear(tokens[0]).transpose(1, 2)
        x = x.reshape(x.shape[0], -1, h // self.patch, w // self.patch)
        return nn.functional.pixel_shuffle(x, self.patch).permute(0, 2, 3, 1)


class Decoder(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.linear = nn.Linear(2 * DIM, DIM)

    def forward(self, hidden: Any, xpos: Any) -> Any:
        return self.linear(hidden)


class CameraHead(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.res_conv = nn.ModuleList([nn.Linear(DIM, DIM) for _ in range(2)])
        self.more_mlps = nn.Sequential(nn.Linear(DIM, DIM), nn.ReLU())
        self.fc_t, self.fc_rot = nn.Linear(DIM, 3), nn.Linear(DIM, 9)


class Pi3(nn.Module):
    """Attributes and steps of Pi3 (pi3/models/pi3.py)."""

    patch_start_idx = 1

    def __init__(self) -> None:
        super().__init__()
        self.encoder, self.rope = Tokens(), RoPE2D()
        self.position_getter: Any = Positions()
        self.register_token = nn.Parameter(torch.randn(1, 1, 1, DIM))
        self.point_decoder, self.conf_decoder, self.camera_decoder = Decoder(), Decoder(), Decoder()
        self.point_head, self.conf_head, self.camera_head = Head(3), Head(1), CameraHead()
        self.register_buffer("image_mean", torch.full((1, 3, 1, 1), 0.45))
        self.register_buffer("image_std", torch.full((1, 3, 1, 1), 0.22))

    def decode(self, hidden: Any, n: Any, h: Any, w: Any) -> Any:
        views = hidden.shape[0]
        place = self.position_getter(views, h // 14, w // 14, hidden.device) + 1
        place = torch.cat([torch.zeros(views, 1, 2).to(place.dtype), place], 1)
        hidden = torch.cat([self.register_token.repeat(1, views, 1, 1)[0], hidden], 1)
        turned = self.rope(hidden[:, None], place)[:, 0]
        # All views of a scene look at each other.
        every = turned.reshape(-1, n * turned.shape[1], DIM)
        mixed = torch.softmax(every @ every.transpose(1, 2), -1) @ every
        return torch.cat([turned, mixed.reshape(turned.shape)], -1), place


class AnyView(nn.Module):
    """A dictionary of maps and cameras, as VGGT and Depth Anything 3 give."""

    def __init__(self, cameras: dict[str, tuple[int, ...]], trailing: bool) -> None:
        super().__init__()
        self.encoder, self.head, self.trailing = Tokens(), Head(2), trailing
        self.attention, self.position_getter = Attention(RotaryPositionEmbedding2D()), Positions()
        self.cameras = cameras
        self.heads = nn.ModuleDict({k: nn.Linear(DIM, int(torch.tensor(s).prod())) for k, s in cameras.items()})
        self.point_head: Any = nn.Linear(1, 1)

    def forward(self, images: Any) -> Any:
        b, n, _, h, w = images.shape
        tokens = self.encoder(images.reshape(b * n, 3, h, w))["x_norm_patchtokens"]
        place = self.position_getter(b * n, h // 14, w // 14, device=images.device)
        # All views of a scene look at each other.
        mixed = self.attention(tokens.reshape(b, -1, DIM), place.reshape(b, -1, 2)).reshape(tokens.shape)
        tokens = tokens + mixed
        maps = self.head([tokens], (h, w)).reshape(b, n, h, w, 2).exp()
        mean = tokens.mean(1)
        out = {k: self.heads[k](mean).reshape(b, n, *s) for k, s in self.cameras.items()}
        depth = maps[..., :1] if self.trailing else maps[..., 0]
        return {"depth": depth, "depth_conf": 1 + maps[..., 1], **out}


class Identity(nn.Linear):
    """A camera head that gives rotations whatever it sees."""

    def forward(self, x: Any) -> Any:
        value = torch.eye(4)[:3] if self.out_features == 12 else torch.diag(torch.tensor([50.0, 50.0, 1.0]))
        return super().forward(x) * 1e-3 + value.flatten()


class Listed(nn.Module):
    """Views in a list, as MapAnything takes them."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder, self.head, self.pose = Tokens(), Head(4), nn.Linear(DIM, 7)

    def forward(self, views: Any) -> Any:
        out = []
        for view in views:
            assert view["data_norm_type"] == ["dinov2"]
            tokens = self.encoder(view["img"])["x_norm_patchtokens"]
            maps, seven = self.head([tokens], view["img"].shape[-2:]), self.pose(tokens.mean(1))
            cam = {"cam_quats": seven[:, :4], "cam_trans": seven[:, 4:]}
            points = torch.cat([maps[..., :2], maps[..., 2:3].exp()], -1)
            out.append({"pts3d_cam": points, "conf": 1 + maps[..., 3].exp(), **cam})
        return out


class PatchEmbed(nn.Module):
    """DUSt3R's for landscape pictures: it sorts them by a tensor of their shapes."""

    def __init__(self) -> None:
        super().__init__()
        self.proj, self.norm = nn.Conv2d(3, DIM, 16, 16), nn.Identity()

    def forward(self, images: Any, true_shape: Any) -> Any:
        height, width = true_shape.T
        landscape = width >= height
        x = self.proj(images)
        tokens = images.new_zeros((len(images), x.shape[2] * x.shape[3], DIM))
        tokens[landscape] = x[landscape].permute(0, 2, 3, 1).flatten(1, 2)
        return self.norm(tokens), blockers.grid_positions(len(images), x.shape[2], x.shape[3], images.device)


class Stereo(nn.Module):
    """Two views, as DUSt3R takes them (dust3r/model.py)."""

    def __init__(self) -> None:
        super().__init__()
        rope = RoPE2D()
        self.patch_embed, self.enc_norm, self.dec_norm = PatchEmbed(), nn.LayerNorm(DIM), nn.LayerNorm(DIM)
        self.enc_blocks = nn.ModuleList([Attention(rope) for _ in range(2)])
        self.dec_blocks = nn.ModuleList([Attention(rope) for _ in range(2)])
        self.downstream_head1, self.downstream_head2 = PairHead(), PairHead()

    def _decoder(self, one: Any, place1: Any, two: Any, place2: Any) -> Any:
        out, n = [(one, two)], one.shape[1]
        for block in self.dec_blocks:
            both = block(torch.cat([one, two], 1), torch.cat([place1, place2], 1))
            one, two = both[:, :n], both[:, n:]
            out.append((one, two))
        out[-1] = (self.dec_norm(one), self.dec_norm(two))
        return zip(*out, strict=True)

    def forward(self, view1: Any, view2: Any) -> Any:
        shape = torch.cat([view1["true_shape"], view2["true_shape"]])
        tokens, place = self.patch_embed(torch.cat([view1["img"], view2["img"]]), true_shape=shape)
        for block in self.enc_blocks:
            tokens = block(tokens, place)
        (one, two), (place1, place2) = self.enc_norm(tokens).chunk(2), place.chunk(2)
        h, w = int(shape.min()), int(shape.max())
        decoded = self._decoder(one, place1, two, place2)
        heads = (self.downstream_head1, self.downstream_head2)
        found = [head(list(side), (h, w)) for head, side in zip(heads, decoded, strict=True)]
        found[1]["pts3d_in_other_view"] = found[1].pop("pts3d")
        return found


class PairHead(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.head = Head(4, 16)

    def forward(self, tokens: Any, size: Any) -> Any:
        maps = self.head([tokens[-1]], size)
        return {"pts3d": torch.cat([maps[..., :2], maps[..., 2:3].exp()], -1), "conf": 1 + maps[..., 3].exp()}


class Single(nn.Module):
    """One view, as MoGe-2 takes it: the number of tokens, an input, sets the size at which the encoder works."""

    onnx_compatible_mode = False

    def __init__(self) -> None:
        super().__init__()
        self.encoder, self.head = nn.Conv2d(3, DIM, 14, 14), nn.Conv2d(DIM, 4, 1)

    def forward(self, image: Any, num_tokens: Any) -> Any:
        assert self.onnx_compatible_mode
        h, w = image.shape[-2:]
        rows, columns = (x.round().long() for x in ((num_tokens * h / w) ** 0.5, (num_tokens * w / h) ** 0.5))
        small = nn.functional.interpolate(image, (14 * rows, 14 * columns), mode="bilinear")
        maps = nn.functional.interpolate(self.head(self.encoder(small)), (h, w), mode="bilinear").permute(0, 2, 3, 1)
        points = torch.cat([maps[..., :2], maps[..., 2:3].exp()], -1)
        return {"points": points, "mask": maps[..., 3].sigmoid(), "metric_scale": maps.mean((1, 2, 3)).exp()}


# ---------------------------------------------------------------- families


def test_pi3(tmp_path: Path) -> None:
    found = exported(pi3, Pi3(), options(tmp_path, exporter="torchscript"))
    spec = found.model.spec
    assert (spec.kind, spec.pose, spec.conf) == ("pointmap", "raw9", "logit")
    # Views and size are really free: two shapes of picture, one to three views.
    assert len(found.trials) == 6
    assert all(t.seconds is not None for t in found.trials)


def test_vggt(tmp_path: Path) -> None:
    found = exported(vggt, AnyView({"pose_enc": (9,)}, trailing=True), options(tmp_path, exporter="torchscript"))
    assert found.model.spec.fit == "pad_white"
    assert found.model.spec.fixed_hw == (28, 42)
    assert [t.views for t in found.trials] == [1, 2, 3]


def test_depth_anything_3(tmp_path: Path) -> None:
    model = AnyView({"extrinsics": (3, 4), "intrinsics": (3, 3)}, trailing=False)
    model.heads = nn.ModuleDict({"extrinsics": Identity(DIM, 12), "intrinsics": Identity(DIM, 9)})
    found = exported(depth_anything_3, model, options(tmp_path, exporter="torchscript"))
    assert (found.model.spec.pose, found.model.spec.norm) == ("w2c", "imagenet")


def test_map_anything(tmp_path: Path) -> None:
    found = exported(map_anything, Listed(), options(tmp_path, views=3, exporter="torchscript"))
    assert found.model.spec.n_static == 3
    assert found.model.spec.scale == "applied"


@pytest.mark.slow
def test_dust3r(tmp_path: Path) -> None:
    torch.manual_seed(0)
    model, images = Stereo().eval(), torch.rand(2, 3, 32, 48)
    views = [{"img": images[k : k + 1], "true_shape": torch.tensor([[32, 48]])} for k in (0, 1)]
    one, two = model(*views)
    expected = one["pts3d"], one["conf"], two["pts3d_in_other_view"], two["conf"]
    torch.testing.assert_close(dust3r.run(model, images), expected)  # the same as by the model's own forward

    found = exported(dust3r, Stereo(), options(tmp_path, size=(32, 48)))
    assert (found.model.spec.kind, found.model.spec.scale) == ("pair", "none")
    with pytest.raises(ExportFailed, match="landscape"):
        dust3r.wrap(Stereo(), options(tmp_path, size=(48, 32)))
    metric = dust3r.wrap(Stereo(), options(tmp_path, weights="naver/MASt3R_metric"))
    assert metric.metadata["scale"] == "applied"


def test_moge(tmp_path: Path) -> None:
    found = exported(moge, Single(), options(tmp_path, views=1))
    assert [p.name for p in found.model.spec.extra_inputs] == ["num_tokens"]
    assert found.model.spec.scale == "factor"


# ---------------------------------------------------------------- what goes wrong


class Changing(nn.Module):
    """Says something else whenever it is asked."""

    def __init__(self) -> None:
        super().__init__()
        self.calls = 0

    def forward(self, images: Any) -> Any:
        self.calls += 1
        return (images * self.calls,)


class Unwritable(nn.Module):
    def forward(self, images: Any) -> Any:
        return (torch.linalg.svd(images.reshape(-1, 3, 3))[1],)


def test_a_graph_that_disagrees_with_torch_is_not_delivered(tmp_path: Path) -> None:
    chosen = options(tmp_path, exporter="torchscript")
    with pytest.raises(ExportFailed, match="disagree beyond"):
        export(Family(Changing(), ("y",), {}), chosen)
    with pytest.raises(ExportFailed, match=r"cannot (write|load)"):
        export(Family(Unwritable(), ("y",), {}), replace(chosen, size=(9, 9)))
    assert list(tmp_path.iterdir()) == []


def test_samples_are_repeatable_pictures(tmp_path: Path) -> None:
    family = Family(nn.Identity(), ("y",), {})
    a, b = (sample(family, 2, (28, 42))["images"] for _ in range(2))
    assert torch.equal(a, b)
    assert a.shape == (1, 2, 3, 28, 42)
    assert 0 <= float(a.min()) < 0.2 < 0.8 < float(a.max()) <= 1
