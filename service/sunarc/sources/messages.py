"""The messages of the commands that read files: why an image was left out, and what a run over a folder came to."""

from __future__ import annotations

from sunarc.calibration.messages import MESSAGES as OF_CALIBRATION
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, Message, Messages

_LEFT_OUT = "The image was left out; nothing is stored of it."

_LAST_LEFT_OUT = "{n} of the last images were left out, as {file}: {why}"
_RIGHT_TO_READ = "give the user of the service the right to read it (a group, or setfacl -m u:sunarc:rX)"
_NO_SIGHTINGS = "Most of the last images gave no sighting."

_NO_PICTURE = "No picture is taken; it is tried again at the next slot."

MESSAGES = Messages(
    file_not_image=Message("{error}", _LEFT_OUT, "give a whole PNG, JPEG, TIFF or JPEG 2000 file of 8 or 16 bits"),
    file_not_read=Message("it cannot be read: {error}", _LEFT_OUT, f"{_RIGHT_TO_READ}; or check its disk or share"),
    file_too_many_pixels=Message(
        "its header states more than {most} pixels", _LEFT_OUT, "delete it, or set the camera to fewer pixels"
    ),
    file_truncated=Message("the file ends before its image does", _LEFT_OUT, "copy it again from its source"),
    file_animated=Message("the file has {frames} frames", _LEFT_OUT, "write each frame to a file of its own"),
    file_cmyk=Message("its colours are CMYK, for print", _LEFT_OUT, "convert it to RGB or grey"),
    file_transparent=Message(
        "{share:.2f} of its pixels are transparent", _LEFT_OUT, "write it without an alpha channel"
    ),
    file_rotated=Message(
        "EXIF orientation {orientation}: readers that follow it show the image rotated or mirrored",
        _LEFT_OUT,
        "remove the tag where all images have it (exiftool -Orientation= -overwrite_original)",
    ),
    file_preview=Message(
        "a preview, whose values are not proportional to the light", _LEFT_OUT, "none: the composite beside it is read"
    ),
    file_copy=Message("another file has the same name, time and exposure", _LEFT_OUT, "none"),
    file_time_pattern=Message("the name does not match {pattern!r}", _LEFT_OUT, "correct --time-pattern"),
    file_time_unknown=Message("no time in its name, sidecar or EXIF", _LEFT_OUT, "give --time-pattern"),
    file_time_header=Message(
        "no DATE-OBS or DATE-AVG in UTC in its header, and no time in its name", _LEFT_OUT, "give --time-pattern"
    ),
    file_time_ambiguous=Message(
        "its name is read as {first} or {second}",
        _LEFT_OUT,
        "give --time-pattern, as %d-%m-%Y_%H-%M-%S",
    ),
    file_time_zone=Message(
        "the time zone of its time {written} is not known",
        _LEFT_OUT,
        "give --utc-offset: the hours that it is ahead of UTC, 0, or a zone as Europe/Berlin",
    ),
    file_zone_contradicts=Message(
        "its time {written} is {hours:+g} h ahead of UTC by its name, and {stated} ahead by the option",
        _LEFT_OUT,
        "leave --utc-offset (folder.utc_offset) out, or correct it",
    ),
    file_time_twice=Message(
        "its time {written} occurred twice in {zone}, when summer time ended",
        _LEFT_OUT,
        "give such images a sidecar with time_utc",
    ),
    file_time_never=Message(
        "its time {written} does not exist in {zone}: summer time began",
        _LEFT_OUT,
        "correct --utc-offset: a camera that does not follow summer time needs hours, as 1",
    ),
    file_time_units=Message(
        "its times are in {units!r}", _LEFT_OUT, "give them in UTC, as seconds since 1970-01-01T00:00:00Z"
    ),
    file_video_times=Message(
        "the times of the video's {frames} frames are unknown: it states none, or plays more than one frame a second "
        "({frames_per_s:~2})",
        "The file was left out; nothing is stored of it.",
        'write NAME.json beside the video NAME.*: {{"times_utc": ["…Z"]}} or {{"start_utc": "…Z", "interval_s": 60}}',
    ),
    file_other_site=Message(
        "its header states {latitude:.2f}° north and {longitude:.2f}° east, {apart_deg:.1f}° from the site (at most "
        "{limit:.0f}°)",
        _LEFT_OUT,
        "correct latitude and longitude (east is positive), or leave the image out",
    ),
    file_sidecar=Message("the sidecar cannot be read: {error}", _LEFT_OUT, 'write {{"time_utc": "…Z"}}'),
    file_at_night=Message(
        "the sun was at {zenith_deg:.1f} degrees from the zenith",
        _LEFT_OUT,
        "none if that is right; otherwise correct --utc-offset",
    ),
    nights_without_calibration=Message(
        "{n} images of the night: no calibration is served to identify their stars with",
        "The images are left out; a later run includes them.",
        "calibrate by the sun first, or with sunarc stars --blind, and run this command again",
    ),
    stars_not_named=Message("no star is identified: {error}", _LEFT_OUT, "none where it shows clouds or the moon"),
    night_between_poses=Message(
        "taken between the last sighting of an epoch and the first of the next, or without a calibration",
        _LEFT_OUT,
        "none: the pose of that night is not known",
    ),
    file_too_large=Message("{bytes} bytes, at most {most} are read", _LEFT_OUT, "give images"),
    image_failed=Message("the detector failed: {error}", _LEFT_OUT, "report it with the image"),
    image_kills_workers=Message(
        "{deaths} workers died while they read it", _LEFT_OUT, "open it in another program; give workers more memory"
    ),
    camera_kills_workers=Message(
        "{deaths} workers died while they fitted it", "The camera has no epochs.", "give workers more memory"
    ),
    camera_without_files=Message(
        "none of its sources has an image file named {files}",
        "The camera was left out.",
        "correct the sources, or files",
    ),
    camera_without_images=Message("no image can be read", "The camera was left out.", "see the reasons of its files"),
    camera_at_night=Message(
        "the sun was below the horizon in all of its {images} images (median {zenith_deg:.0f} degrees from the zenith)",
        "The camera was left out.",
        "correct latitude, longitude (east is positive) or --utc-offset, or give images of the day",
    ),
    cameras_mixed=Message(
        "{copies} of its {images} images have the name and time of another image ({file}, {other})",
        "The camera was left out: these are the images of two cameras.",
        "give --cameras FILE with a table for each, and their own sources",
    ),
    camera_mirrored=Message(
        "the sightings fit mirrored = {mirrored!r} only",
        "Its calibrations are refused.",
        "give --mirrored {mirrored}; or correct the latitude's sign",
    ),
    sightings_disagree=Message(
        "{share:.2f} of the sightings agree on a camera, {least:.2f} have to",
        "The camera has no epochs.",
        "check that the images are those of one camera, and show the sun",
    ),
    sightings_alternate=Message(
        "{changes} times of {n} the next sighting of a day is that of another camera or clock",
        "The camera has no epochs: these are the images of two cameras.",
        "give --cameras FILE with a table for each, and their own sources or patterns of names",
    ),
    days_of_two_states=Message(
        "the sightings of any few days scatter by {scatter_px:.2f} px about one camera (at most {limit_px:.2f} px by "
        "their own noise)",
        "The camera has no epochs.",
        "check that the images are those of one camera that stands still for days, and show the sun",
    ),
    worker_died=Message("the process that read it died: {error}", _LEFT_OUT, "open it in another program"),
    mirrored_setting_differs=Message(
        "the sightings fit a camera with mirrored = {mirrored!r}, and calibration.mirrored is not that",
        "A refit with these settings is refused.",
        'set calibration.mirrored = "{mirrored}"',
    ),
    sigma_learned=Message(
        "sigma of sightings in images ({method}): {factor:.2f} times the detector's, estimated from {n} sightings",
        "It was set to their scatter about the calibration; later sightings are stored with it.",
    ),
    file_time_range=Message(
        "its time, {written}, is not within the years 1970 to 2100",
        _LEFT_OUT,
        "correct the clock of the camera, or folder.time_pattern",
    ),
    file_time_future=Message(
        "its time is {ahead_s:.0f} s ahead of this machine's clock",
        _LEFT_OUT,
        "correct folder.utc_offset, or the clock of the camera or of this machine",
    ),
    file_time_repeated=Message(
        "{n} images state its time, at most {most} are exposures of one scene",
        _LEFT_OUT,
        "have the names state seconds",
    ),
    file_other_camera=Message(
        "its name begins with {prefix!r}, those of most images with {usual!r}",
        _LEFT_OUT,
        "set folder.files to the names of one camera",
    ),
    file_latest=Message("a file without a time that is written over again and again", _LEFT_OUT, "none"),
    images_without_zone=Message(
        _LAST_LEFT_OUT,
        _NO_SIGHTINGS,
        "set folder.utc_offset: the hours that the times are ahead of UTC, 0, or a zone as Europe/Berlin",
    ),
    images_without_time=Message(
        _LAST_LEFT_OUT,
        _NO_SIGHTINGS,
        "have the camera write the time into the names, or set folder.time_pattern",
    ),
    images_of_another_size=Message(
        _LAST_LEFT_OUT,
        _NO_SIGHTINGS,
        "set the camera's size and crop as they were; or begin anew under another `name`",
    ),
    images_of_two_cameras=Message(
        _LAST_LEFT_OUT,
        "The images of one camera are used.",
        "set folder.files to the names of one camera, and run a service for each",
    ),
    images_in_future=Message(
        _LAST_LEFT_OUT,
        _NO_SIGHTINGS,
        "correct folder.utc_offset, or the clock of the camera or of this machine",
    ),
    images_left_out=Message(_LAST_LEFT_OUT, _NO_SIGHTINGS, "{remedy}"),
    image_times_offset=Message(
        "images come {hours:+.2f} h after the times that they state",
        "The sun stood elsewhere at those times: no calibration can come of them.",
        "correct folder.utc_offset; where images really are delivered so late there is nothing to do",
    ),
    image_times_late=Message(
        "images come {late_s} s after the times that they state, each of the last ones alike",
        "A clock that is wrong by so much turns north by 0.25° a minute; no calibration can tell.",
        "compare the camera's clock with this host's (NTP); where images really come so late there is nothing to do",
    ),
    folder_missing=Message(
        "{folder} cannot be read: {error}",
        "No image comes; it is looked for again every few seconds.",
        "check folder.path, and that its disk or share is mounted",
    ),
    folder_not_permitted=Message(
        "{folder} may not be read: {error}",
        "No image of it is taken; it is tried every few seconds.",
        _RIGHT_TO_READ,
    ),
    no_new_image=Message(
        "no image for {minutes} minutes; the newest is {file} of {time}",
        "By day an image is expected at every cadence.",
        "check the program that writes them, its network, and the share",
    ),
    http_unreachable=Message(
        "{host} does not answer: {error}",
        _NO_PICTURE,
        "check http.url, the camera's power and network, and a firewall between",
    ),
    http_certificate=Message(
        "the certificate of {host} is not accepted: {error}",
        _NO_PICTURE,
        "give the camera's certificate, or its authority's, as http.ca_file; check its name and this host's clock",
    ),
    http_denied=Message(
        "{host} answers {status}: it asks for another user or password",
        _NO_PICTURE,
        "write USER:PASSWORD in one line of http.token_file, readable by the service",
    ),
    http_login=Message(
        "{host} asks for a login by {offers}, which cannot be answered safely",
        "The password is not sent.",
        "set the camera's authentication to Digest (MD5 or SHA-256), or to Basic alone",
    ),
    http_redirected=Message(
        "{host} refers to another host, {location}",
        "It is not followed, for it would be given the password.",
        "set http.url to the address that the picture has",
    ),
    http_status=Message("{host} answers {status}", _NO_PICTURE, "check the path of http.url"),
    http_no_picture=Message(
        "{host} answers with no picture: {why}",
        _NO_PICTURE,
        "open http.url in a browser: it has to show a JPEG or PNG picture alone, no page and no video",
    ),
    http_too_large=Message(
        "the answer of {host} is longer than {most} bytes, or has no end",
        _NO_PICTURE,
        "set http.url to a single picture, not to a stream (MJPEG)",
    ),
    http_too_many_pixels=Message(
        "the picture has {width}x{height} px, more than {most} in all", _NO_PICTURE, "have the camera send smaller ones"
    ),
    http_stale=Message(
        "the picture is {age_s:.0f} s old, as its headers state (Date, Last-Modified, Age)",
        "It is left out: the sun stood elsewhere.",
        "ask the camera itself, without a cache between; give the address of a live picture",
    ),
    http_refused=Message("the picture cannot be used: {why}", _NO_PICTURE, "{remedy}"),
    rtsp_unreachable=Message(
        "{host} does not answer by RTSP: {error}",
        _NO_PICTURE,
        "check rtsp.url (its port, mostly 554), the camera's power and network, and a firewall between",
    ),
    rtsp_denied=Message(
        "{host} answers {status}: it asks for another user or password",
        _NO_PICTURE,
        "write USER:PASSWORD in one line of rtsp.token_file, readable by the service",
    ),
    rtsp_login=Message(
        "{host} asks for a login by {offers}, which the decoder cannot answer safely",
        "The password is not sent.",
        "set the camera's RTSP authentication to Digest with MD5 alone",
    ),
    rtsp_status=Message(
        "{host} answers {status}", _NO_PICTURE, "check the path of rtsp.url; an address that redirects is not followed"
    ),
    rtsp_no_frame=Message(
        "the stream of {host} gives {why} within {within_s:g} s",
        _NO_PICTURE,
        "have the camera send H.264, H.265 or MJPEG by TCP, with a key frame (I-frame) every few seconds",
    ),
    rtsp_too_many_pixels=Message(
        "the stream has {width}x{height} px, more than {most} in all", _NO_PICTURE, "have the camera send smaller ones"
    ),
    rtsp_refused=Message("the frame cannot be used: {why}", _NO_PICTURE, "{remedy}"),
    archive_in_work=Message(
        "{n} older images of the folder are analysed behind the live ones; {stored} sightings so far",
        "Their days are judged afterwards.",
        "wait; `sunarc ingest` does the same at once, with the service stopped",
    ),
    archive_failed=Message(
        "the older images of the folder could not be analysed: {error}",
        "Live images are not affected; it is tried again after an hour.",
        "see the log; run sunarc ingest with the folder by hand",
    ),
    file_size_differs=Message(
        "image size {width}x{height} px, the camera's is {camera_width}x{camera_height}",
        _LEFT_OUT,
        "give images of another size another camera name",
    ),
)


class RefusedImageError(InputError):
    """An image that is left out.

    Parameters
    ----------
    name : the file, or its part that is wrong.
    finding : why, of `MESSAGES`.
    """

    def __init__(self, name: str, finding: Finding) -> None:
        super().__init__(field=name, problem=MESSAGES.text_of(finding), remedy=MESSAGES.remedy_of(finding))
        self.finding = finding


def sentence_of(finding: Finding, *tables: Messages) -> str:
    """Return a finding of a run over images as a sentence with its remedy, by these tables or further ones."""
    table = next((table for table in (MESSAGES, OF_CALIBRATION, *tables) if finding.code in table), MESSAGES)
    return f"{table.text_of(finding)}; {table.remedy_of(finding)}"
