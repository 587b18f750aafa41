"""The detector's network: a canonical view in, heat maps of the 18 labels out.

`default` is a residual encoder with a light decoder to 1/4 of the view, for two processor cores;
`small` the same at half the size, for comparisons of training; `paper` is the paper's ResNet-101
cut to stride 8 on 640 x 512; `tiny` is for tests. All end in the same head: a heat map for each
label, and, from the features at its peak, the label's visibility (visible, occluded, absent) and
the standard deviation of its position.
Source: EgoCap paper, section 4.3.2; He et al. 2016 (residual blocks); Lin et al. 2017 (decoder).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from egocap.body.labels import LABELS
from egocap.detect.canonical_view import ViewSpec
from egocap.errors import InputError

VISIBLE, OCCLUDED, ABSENT = range(3)
"""Order of the first three channels of `info`; the fourth is log sigma."""

STRIDES = {"pyramid": 4, "resnet101": 8}
"""View pixels per heat-map cell of each kind of network."""

MOST_LEVELS, LONGEST_NAME = 8, 80
LIMITS = {"widths": (1, 1024), "blocks": (0, 64), "decoder": (1, 1024)}
"""Smallest and largest number in these fields of a configuration."""

_MEAN, _SCALE = 110.0, 60.0  # normalisation of pixel values


@dataclass(frozen=True)
class NetworkConfig:
    """Architecture of a network. Raises InputError for a view that does not fit the strides."""

    name: str
    view: ViewSpec = field(default_factory=ViewSpec)
    kind: Literal["pyramid", "resnet101"] = "pyramid"
    stride: int = 4  # view pixels per heat-map cell
    widths: tuple[int, ...] = (32, 48, 96, 192, 256)  # channels at 1/2, 1/4, 1/8, ...
    blocks: tuple[int, ...] = (0, 1, 1, 2, 2)  # residual blocks there
    decoder: tuple[int, ...] = (64, 96, 128)  # channels of the decoder at 1/4, 1/8, 1/16

    def __post_init__(self) -> None:
        self._check_values()
        step = 8 if self.kind == "resnet101" else 2 ** len(self.widths)
        if self.view.width % step or self.view.height % step:
            raise InputError(
                f"network '{self.name}' with a view of {self.view.width} x {self.view.height}",
                valid=f"multiples of {step}",
            )
        if len(self.blocks) != len(self.widths) or len(self.decoder) != len(self.widths) - 2:
            raise InputError(
                f"network '{self.name}' with {len(self.widths)} widths, {len(self.blocks)} counts "
                f"of blocks and {len(self.decoder)} widths of the decoder",
                valid="as many blocks as widths, two decoder widths fewer",
            )

    def _check_values(self) -> None:
        """Raise InputError for values beyond the limits; they may come from a file."""
        if not (isinstance(self.name, str) and len(self.name) <= LONGEST_NAME):
            raise InputError(f"network 'name' {self.name!r:.80}",
                             valid=f"text of at most {LONGEST_NAME} characters")  # fmt: skip
        if self.stride != STRIDES.get(self.kind):
            valid = ", ".join(f"{kind} of {stride}" for kind, stride in STRIDES.items())
            raise InputError(
                f"network 'kind' {self.kind!r:.80} of 'stride' {self.stride!r:.80}", valid=valid
            )
        for key, (low, high) in LIMITS.items():
            values = getattr(self, key)
            if not (isinstance(values, tuple) and 1 <= len(values) <= MOST_LEVELS
                    and all(type(v) is int and low <= v <= high for v in values)):  # fmt: skip
                raise InputError(f"network '{key}' {values!s:.80}",
                                 valid=f"1 to {MOST_LEVELS} numbers, {low} to {high}")  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready form, read by `config_from_dict`."""
        return asdict(self)


CONFIGS: dict[str, NetworkConfig] = {
    "default": NetworkConfig("default", ViewSpec(near_pitch_deg=85.0, boom_focal=150.0)),
    "paper": NetworkConfig(
        "paper", ViewSpec(640, 512, 204.0, 0.0, 90.0, 0.0), kind="resnet101", stride=8
    ),
    "small": NetworkConfig(
        "small", ViewSpec(128, 112, 58.5), widths=(16, 32, 64, 128), blocks=(0, 1, 1, 2),
        decoder=(32, 64),
    ),
    "tiny": NetworkConfig(
        "tiny", ViewSpec(64, 64, 28.0), widths=(8, 16, 16, 24), blocks=(0, 0, 1, 1),
        decoder=(16, 16),
    ),
}  # fmt: skip
"""The named configurations."""


def config_named(name: str) -> NetworkConfig:
    """The configuration of that name. Raises InputError."""
    if name not in CONFIGS:
        raise InputError(f"unknown network '{name}'", valid=CONFIGS)
    return CONFIGS[name]


def config_from_dict(data: dict[str, Any]) -> NetworkConfig:
    """Configuration from the form of `NetworkConfig.to_dict`. Raises InputError."""
    try:
        values: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in data.items()
        }
        values["view"] = ViewSpec(**data["view"])
        return NetworkConfig(**values)
    except (TypeError, KeyError, AttributeError, ValueError) as error:
        raise InputError(f"not a network's configuration: {error}") from None


def build_network(config: NetworkConfig) -> DetectorNetwork:
    """A network with random weights, drawn from torch's default generator."""
    return DetectorNetwork(config)


class DetectorNetwork(nn.Module):
    """Images (B, H, W, 3), RGB 0..255 -> heat (B, 18, h, w), info (B, 18, 4).

    `heat`: logits over cells. `info`: logits of VISIBLE, OCCLUDED, ABSENT, and the logarithm of the
    standard deviation, along each axis, of the place decoded from the heat map [view pixels].
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        if config.kind == "resnet101":
            self.body: nn.Module = ResNet101()
            features, context = 2048, 2048
        else:
            self.body = Pyramid(config)
            features, context = config.decoder[0], config.widths[-1]
        self.heat = nn.Conv2d(features, len(LABELS), 1)
        self.info = LabelInfo(features, context)
        nn.init.normal_(self.heat.weight, std=0.01)
        nn.init.zeros_(self.heat.bias)  # type: ignore[arg-type]

    def forward(
        self, images: Float[Tensor, "B H W 3"]
    ) -> tuple[Float[Tensor, "B 18 h w"], Float[Tensor, "B 18 4"]]:
        """Heat maps and `info` of each label."""
        x = (images.permute(0, 3, 1, 2).to(self.heat.weight.dtype) - _MEAN) * (1.0 / _SCALE)
        features, context = self.body(x)
        heat = self.heat(features).float()
        return heat, self.info(features, context, heat)


class LabelInfo(nn.Module):
    """Visibility and log sigma of each label from features weighted by its heat map."""

    def __init__(self, features: int, context: int, hidden: int = 64) -> None:
        super().__init__()
        labels = len(LABELS)
        self.local = nn.Linear(features, hidden)
        self.context = nn.Linear(context, hidden)
        self.label = nn.Parameter(torch.randn(labels, hidden) * 0.5)
        self.weight = nn.Parameter(torch.randn(labels, 4, hidden) * hidden**-0.5)
        self.bias = nn.Parameter(torch.tensor([[1.0, 0.0, 0.0, 1.0]]).repeat(labels, 1))
        self.log_sigma_bias = nn.Buffer(torch.zeros(labels))  # fitted on held-out images

    def forward(self, features: Tensor, context: Tensor, heat: Tensor) -> Float[Tensor, "B 18 4"]:
        """`features` (B, C, h, w), `context` (B, D), `heat` (B, 18, h, w) -> info."""
        where = heat.detach().flatten(2)
        p = torch.softmax(where, -1)
        spread = -(p * F.log_softmax(where, -1)).sum(-1, keepdim=True)  # entropy, nats
        found = torch.bmm(p.to(features.dtype), features.flatten(2).transpose(1, 2))
        x = self.local(found) + self.context(context)[:, None]
        x = F.relu(x.float() + self.label)
        info = torch.einsum("blh,lkh->blk", x, self.weight) + self.bias
        sigma = info[..., 3:] + 0.25 * spread + self.log_sigma_bias[:, None]
        return torch.cat([info[..., :3], sigma], -1)


class Pyramid(nn.Module):
    """Residual encoder, and a decoder that adds each level's features to the coarser ones'."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        widths, decoder = config.widths, config.decoder
        self.stages = nn.ModuleList()
        before = 3
        for width, count in zip(widths, config.blocks, strict=True):
            blocks = [BasicBlock(width) for _ in range(count)]
            self.stages.append(nn.Sequential(conv(before, width, 3, 2), *blocks))
            before = width
        self.top = conv(widths[-1], decoder[-1], 1)
        self.lateral = nn.ModuleList(
            conv(w, d, 1, relu=False) for w, d in zip(widths[1:-1], decoder, strict=True)
        )
        self.narrow = nn.ModuleList(
            conv(above, here, 1, relu=False)
            for here, above in zip(decoder, (*decoder[1:], decoder[-1]), strict=True)
        )
        self.smooth = nn.ModuleList(conv(d, d, 3) for d in decoder)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Features at 1/4 of the input, and the mean of the coarsest."""
        levels = []
        for stage in self.stages:
            x = stage(x)
            levels.append(x)
        context = x.mean((2, 3))
        x = self.top(x)
        for level in reversed(range(len(self.lateral))):
            x = F.interpolate(self.narrow[level](x), scale_factor=2.0, mode="nearest")
            x = self.smooth[level](F.relu(x + self.lateral[level](levels[level + 1])))
        return x, context


class BasicBlock(nn.Module):
    """Two 3 x 3 convolutions and a shortcut."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = conv(width, width, 3)
        self.second = conv(width, width, 3, relu=False, gain=0.2)

    def forward(self, x: Tensor) -> Tensor:
        """Same shape."""
        return F.relu(x + self.second(self.first(x)))


class ResNet101(nn.Module):
    """The paper's network at stride 8: the last two stages are dilated."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = conv(3, 64, 7, 2)
        self.pool = nn.MaxPool2d(3, 2, 1)
        stages: list[nn.Module] = []
        before = 64
        for width, count, stride, dilation in (
            (64, 3, 1, 1), (128, 4, 2, 1), (256, 23, 1, 2), (512, 3, 1, 4),
        ):  # fmt: skip
            for i in range(count):
                stages.append(Bottleneck(before, width, stride if i == 0 else 1, dilation))
                before = 4 * width
        self.stages = nn.Sequential(*stages)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Features at 1/8 of the input, and their mean."""
        x = self.stages(self.pool(self.stem(x)))
        return x, x.mean((2, 3))


class Bottleneck(nn.Module):
    """1 x 1, 3 x 3, 1 x 1 convolutions and a shortcut."""

    def __init__(self, before: int, width: int, stride: int, dilation: int) -> None:
        super().__init__()
        self.inner = nn.Sequential(
            conv(before, width, 1),
            conv(width, width, 3, stride, dilation=dilation),
            conv(width, 4 * width, 1, relu=False, gain=0.2),
        )
        same = before == 4 * width and stride == 1
        self.shortcut = nn.Identity() if same else conv(before, 4 * width, 1, stride, relu=False)

    def forward(self, x: Tensor) -> Tensor:
        """Four times `width` channels."""
        return F.relu(self.shortcut(x) + self.inner(x))


def conv(
    before: int, after: int, size: int, stride: int = 1, *,
    relu: bool = True, dilation: int = 1, gain: float = 1.0,
) -> nn.Sequential:  # fmt: skip
    """Convolution, batch normalisation (initial scale `gain`) and optional ReLU."""
    layer = nn.Conv2d(
        before, after, size, stride, dilation * (size // 2), dilation=dilation, bias=False
    )
    nn.init.kaiming_normal_(layer.weight, mode="fan_out", nonlinearity="relu")
    norm = nn.BatchNorm2d(after)
    nn.init.constant_(norm.weight, gain)
    return nn.Sequential(layer, norm, *([nn.ReLU(inplace=True)] if relu else []))
