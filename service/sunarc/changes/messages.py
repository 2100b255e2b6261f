"""Messages of changes between one sighting and the next."""

from __future__ import annotations

from sunarc.common.findings import Message, Messages

_AGREE = "{alternatives}; {agreeing} of {of} sightings since agree"

MESSAGES = Messages(
    # changes between one sighting and the next
    changed_bump=Message(
        f"camera turned by {{size:.3f}} ± {{sigma:.3f}}°{_AGREE}",
        "A pose epoch begins; the pose is estimated anew.",
        "none if the camera stays as it is; otherwise check its mount",
    ),
    changed_clock=Message(
        f"the clock that dates the frames jumped by {{size:+.2f}} ± {{sigma:.2f}} s{_AGREE}",
        "The calibration is kept; sightings are left out until the clock is right.",
        "let a time service set the host's clock",
    ),
    changed_lens=Message(
        f"lens changed, or refocused and shifted against the sensor{_AGREE}",
        "No calibration is served until the next clear day.",
        "none if a lens was changed or focused: it is calibrated anew from the next clear days",
    ),
    changed_refocus=Message(
        f"focus changed: image scale {{size:+.2f}} ± {{sigma:.2f}} %{_AGREE}",
        "No calibration is served until the next clear day.",
        "fix the focus ring; the camera is calibrated anew from the next clear days",
    ),
    changed_shift=Message(
        f"sensor shifted behind the lens by {{size:.2f}} ± {{sigma:.2f}} px{_AGREE}",
        "No calibration is served until the next clear day.",
        "check what holds lens and sensor together; the camera is calibrated anew from the next clear days",
    ),
    changed_mirrored=Message(
        f"image mirrored against the calibration{_AGREE}",
        "Sightings are left out until the image is as before.",
        "set the camera's image back as it was (reverse X, reverse Y)",
    ),
    changed_site=Message(
        "the sun is where it would be over a site with the opposite sign of latitude or longitude{alternatives}; "
        "{agreeing} of {of} sightings since then agree",
        "Sightings are left out until the site is right.",
        "correct the sign of site.latitude or site.longitude in the settings",
    ),
)
