import pytest
import torch

from novags.methods.nova import resunet
from novags.methods.nova.denoiser_config import ResUNetConfig
from novags.methods.nova.resunet import Convolution, ResUNet, SqueezeExcite

SMALL = ResUNetConfig(widths=(4, 6), bottleneck=8)


def test_default_network_is_the_papers():
    network = ResUNet()
    widths = [level.enter[0].out_channels for level in network.encoder]
    assert widths == [32, 64, 128, 256]
    assert network.bottleneck.enter[0].out_channels == 512
    assert [level.enter[0].in_channels for level in network.decoder] == [64, 128, 256, 512]
    assert sum(isinstance(m, Convolution) and m.edge == 3 for m in network.modules()) == 9 * 3
    assert sum(isinstance(m, torch.nn.InstanceNorm2d) for m in network.modules()) == 9 * 3
    assert sum(isinstance(m, SqueezeExcite) for m in network.modules()) == 9
    assert network.encoder[3].residual[-1].gate[1].out_channels == 256 // 16


@pytest.mark.parametrize("size", [(1, 1), (3, 50), (17, 23), (16, 32), (40, 33)])
def test_any_size_goes_in_and_comes_out(size):
    images = torch.rand(2, 3, *size)
    out = ResUNet(SMALL)(images)
    assert out.shape == images.shape
    assert torch.isfinite(out).all()


def test_padding_leaves_multiples_of_the_step_alone_and_is_cropped_off_otherwise():
    torch.manual_seed(0)
    network = ResUNet(ResUNetConfig(widths=(4, 6), bottleneck=8, normalization="none"))
    image = torch.rand(1, 3, 32, 32)
    padded = torch.nn.functional.pad(image[..., :30, :29], (0, 3, 0, 2), mode="reflect")
    torch.testing.assert_close(network(image[..., :30, :29]), network(padded)[..., :30, :29])


def test_every_weight_receives_gradient():
    torch.manual_seed(0)
    network = ResUNet(ResUNetConfig(widths=(4, 6), bottleneck=8, normalization="none"))
    network(torch.rand(2, 3, 16, 16)).square().sum().backward()
    silent = [name for name, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    # A gate's hidden unit may start dead (ReLU); its bias and weight then wait for another input.
    assert [name for name in silent if "gate" not in name] == []


def test_instance_normalisation_forgets_brightness_and_none_does_not():
    torch.manual_seed(0)
    image = torch.rand(1, 3, 32, 32)
    outputs = {}
    for kind in ("instance", "none"):
        network = ResUNet(ResUNetConfig(widths=(4, 6), bottleneck=8, normalization=kind))
        outputs[kind] = (network(image) - network(3 * image)).abs().max().item()
    assert outputs["instance"] < 1e-2 < outputs["none"]


def test_bfloat16_stays_close_to_float32():
    torch.manual_seed(0)
    exact = ResUNet(SMALL)
    coarse = ResUNet(ResUNetConfig(widths=(4, 6), bottleneck=8, precision="bfloat16"))
    coarse.load_state_dict(exact.state_dict())
    image = torch.rand(1, 3, 32, 32)
    a, b = exact(image), coarse(image)
    assert b.dtype == torch.float32
    assert (a - b).abs().max() < 0.1 * a.abs().max()


def test_the_gate_scales_channels():
    gate = SqueezeExcite(8, 16)
    x = torch.rand(2, 8, 5, 5) + 0.1
    ratio = gate(x) / x
    torch.testing.assert_close(ratio, ratio[..., :1, :1].expand_as(ratio))
    assert ((ratio > 0) & (ratio < 1)).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"widths": ()}, r"widths and bottleneck must be >= 1 channel, got \(\) and"),
        ({"bottleneck": 0}, "widths and bottleneck must be >= 1 channel, got .* and 0"),
        ({"se_reduction": 0}, "se_reduction must be >= 1, got 0"),
    ],
)
def test_impossible_configurations_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        ResUNetConfig(**wrong)


@pytest.mark.parametrize("blocks", ["attention-residual", "plain"])
def test_a_step_on_large_pictures_gives_the_same_gradients_and_holds_few_maps(monkeypatch, blocks):
    """Held are tensors that autograd keeps for the way back, but for those that are computed again."""
    torch.manual_seed(0)
    network = ResUNet(ResUNetConfig(widths=(8, 16), bottleneck=16, blocks=blocks))
    images, results = torch.rand(1, 3, 40, 24), []
    for many in (1 << 18, 1):
        monkeypatch.setattr(resunet, "MANY", many)
        network.zero_grad()
        held = []
        with torch.autograd.graph.saved_tensors_hooks(lambda t, held=held: held.append(t.numel()) or t, lambda t: t):
            loss = network(images).square().mean()
        loss.backward()
        results.append((loss.detach(), [p.grad.clone() for p in network.parameters()], sum(held)))
    (one, gradients, all_maps), (other, again, few_maps) = results
    assert torch.equal(one, other)
    assert all(torch.equal(a, b) for a, b in zip(gradients, again, strict=True))
    assert few_maps < all_maps / 4
