import pytest
import torch

from photometric_reference import photometric_loss_reference
from splatwire.neural.training.photometric_loss import photometric_loss, prepare_photo


def _pair(height: int, width: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    rng = torch.Generator().manual_seed(seed)
    photo = torch.rand(height, width, 3, generator=rng)
    return photo + 0.1 * torch.randn(height, width, 3, generator=rng), photo


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 20), (11, 11), (37, 50)])
@pytest.mark.parametrize("dssim", [0.0, 0.2, 1.0])
def test_loss_and_gradient_equal_the_reference(height: int, width: int, dssim: float) -> None:
    image, photo = _pair(height, width)
    own, theirs = image.clone().requires_grad_(), image.double().requires_grad_()
    loss, error = photometric_loss(own, prepare_photo(photo), dssim)
    reference, reference_error = photometric_loss_reference(theirs, photo.double(), dssim)
    (3 * loss).backward()
    (3 * reference).backward()
    torch.testing.assert_close(loss.double(), reference, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(error.double(), reference_error)
    assert own.grad is not None
    assert theirs.grad is not None
    torch.testing.assert_close(own.grad.double(), theirs.grad, atol=1e-4 * float(theirs.grad.abs().max()), rtol=1e-3)


def test_reference_gradient_equals_finite_differences() -> None:
    image, photo = _pair(5, 6, seed=1)
    assert torch.autograd.gradcheck(
        lambda x: photometric_loss_reference(x, photo.double(), 0.2)[0], image.double().requires_grad_()
    )


def test_perfect_picture_has_zero_loss() -> None:
    _, photo = _pair(16, 16)
    loss, error = photometric_loss(photo.clone().requires_grad_(), prepare_photo(photo), 0.2)
    assert float(loss.detach()) == pytest.approx(0, abs=1e-5)
    assert float(error) == 0


def test_masked_pixels_have_zero_gradient() -> None:
    image, photo = _pair(24, 30)
    mask = torch.zeros(24, 30, dtype=torch.bool)
    mask[:, :10] = True
    own = image.clone().requires_grad_()
    photometric_loss(own, prepare_photo(photo, mask), 0.2)[0].backward()
    assert own.grad is not None
    assert float(own.grad[:, :10].abs().min()) > 0
    assert float(own.grad[:, 21:].abs().max()) < 1e-6  # outside of SSIM's window only rounding differs
    whole = torch.ones_like(mask)
    masked, plain = (photometric_loss(image, prepare_photo(photo, m), 0.2)[0] for m in (whole, None))
    torch.testing.assert_close(masked, plain)
