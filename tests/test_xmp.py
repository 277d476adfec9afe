# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""XMP that is no XML, and XMP of other makers: what is sound in it is used, and what is not is told."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest
from little_photos import check, save, sound_folder
from test_metadata import DJI_ATTRIBUTES, DJI_ELEMENTS

from curecon_blender.core.base.records import Gimbal
from curecon_blender.core.photos import xmp
from curecon_blender.core.photos.metadata import Metadata, read_metadata


def told_by(folder: Path, packet: bytes) -> Metadata:
    return read_metadata(save(folder / "x.jpg", 1, xmp=packet))


@pytest.mark.parametrize(("spoilt", "fault"), [
    (DJI_ATTRIBUTES.replace(b" drone-dji:Rel", b' photoshop:Credit="me" drone-dji:Rel'), "unbound prefix"),
    (DJI_ELEMENTS.replace(b"</rdf:Desc", b"<dc:title>x</dc:title></rdf:Desc"), "unbound prefix"),
    (DJI_ATTRIBUTES.replace(b" drone-dji:Rel", b' drone-dji:Site="Smith & Sons" drone-dji:Rel'), "not well-formed"),
    (DJI_ELEMENTS.replace(b"<drone-dji:Abs", b"<drone-dji:A>A & B</drone-dji:A><drone-dji:Abs"), "not well-formed"),
    (DJI_ATTRIBUTES.replace(b" drone-dji:Rel", b' drone-dji:Rel="1" drone-dji:Rel="1" drone-dji:Rel'), "duplicate"),
    (DJI_ATTRIBUTES.replace(b"/>", b">"), "mismatched tag"),
    (DJI_ATTRIBUTES[: DJI_ATTRIBUTES.index(b"</rdf:RDF>")], "no element|unclosed|mismatched"),
    (DJI_ATTRIBUTES.replace(b' xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"', b""), "unbound prefix"),
], ids=["prefix", "element's prefix", "bare &", "bare & in text", "repeated", "unclosed", "no end", "DJI's own prefix"])
def test_a_faulty_packet_keeps_what_is_sound(tmp_path: Path, spoilt: bytes, fault: str) -> None:
    told = told_by(tmp_path, spoilt)
    assert told.gps is not None
    assert (told.gps.latitude, told.gps.longitude, told.gps.altitude) == (45.03159568, -7.62046587, 349.58)
    assert told.gimbal == Gimbal(yaw=-106.8, pitch=-89.9, roll=0.1)
    assert told.relative_altitude == 44.47
    assert re.search(fault, told.xmp_fault)


def test_what_is_cut_in_the_midst_of_a_value_is_not_believed(tmp_path: Path) -> None:
    for packet, end in ((DJI_ATTRIBUTES, b'+44.4'), (DJI_ELEMENTS, b'+44.4')):
        told = told_by(tmp_path, packet[: packet.index(end) + len(end)])
        assert told.relative_altitude is None
        assert told.xmp_fault


def test_what_is_said_twice_and_differently_is_not_believed(tmp_path: Path) -> None:
    packet = DJI_ATTRIBUTES.replace(b" drone-dji:Rel", b' drone-dji:RelativeAltitude="+12" drone-dji:Rel')
    told = told_by(tmp_path, packet)
    assert told.relative_altitude is None and told.gimbal is not None
    assert "RelativeAltitude" in told.xmp_fault


def test_a_sound_packet_has_no_fault_and_notes_tell_nothing(tmp_path: Path) -> None:
    note = b'<!-- <drone-dji:RelativeAltitude>+1</drone-dji:RelativeAltitude> --><drone-dji:Abs'
    told = told_by(tmp_path, DJI_ELEMENTS.replace(b"<drone-dji:Abs", note))
    assert (told.xmp_fault, told.relative_altitude) == ("", 44.47)


def test_the_user_is_told_once_of_all_faulty_packets(tmp_path: Path) -> None:
    folder = sound_folder(tmp_path)
    for number in (4, 5):
        save(folder / f"DJI_{number}.JPG", number, xmp=DJI_ATTRIBUTES.replace(b"/>", b">"))
    photo_set, warnings = check(folder)
    (warning,) = warnings
    assert "XMP of 2 photos" in warning and "DJI_4.JPG" in warning and "mismatched tag" in warning
    assert len(photo_set.photos) == 5


def packet(prefix: str, uri: str, body: str) -> bytes:
    return (f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
            f'<rdf:Description rdf:about="" xmlns:{prefix}="{uri}" {body}</rdf:RDF></x:xmpmeta>').encode()


PIX4D = "http://pix4d.com/camera/1.0"


@pytest.mark.parametrize(("written", "gimbal", "relative"), [
    (packet("Camera", PIX4D, 'Camera:Yaw="2.42" Camera:Pitch="66.04" Camera:Roll="0.5"/>'),
     Gimbal(yaw=2.42, pitch=pytest.approx(-23.96), roll=0.5), None),  # Autel EVO II, senseFly: from the nadir
    (packet("Camera", PIX4D + "/", ">" + "".join(
        f"<Camera:{name}>{value}</Camera:{name}>" for name, value in
        (("Yaw", "9000/100"), ("Pitch", "500/100"), ("Roll", "-100/100"), ("AboveGroundAltitude", "81.5")))
        + "</rdf:Description>"), Gimbal(yaw=90.0, pitch=-85.0, roll=-1.0), 81.5),
    (packet("drone", "http://www.autel.example/drone/1.0/", 'drone:GimbalYawDegree="10" drone:GimbalPitchDegree="-60" '
            'drone:GimbalRollDegree="0" drone:RelativeAltitude="30"/>'), Gimbal(yaw=10, pitch=-60, roll=0), 30.0),
    (packet("drone-parrot", "http://www.parrot.com/drone-parrot/1.0/", 'drone-parrot:CameraYawDegree="176.3" '
            'drone-parrot:CameraPitchDegree="-78.4" drone-parrot:CameraRollDegree="-0.3"/>'),
     Gimbal(yaw=176.3, pitch=-78.4, roll=-0.3), None),
    (packet("drone-skydio", "https://www.skydio.com/drone-skydio/1.0/", 'drone-skydio:RelativeAltitude="22.5">'
            '<drone-skydio:CameraOrientationNED rdf:parseType="Resource"><drone-skydio:Roll>0.2</drone-skydio:Roll>'
            "<drone-skydio:Pitch>-84</drone-skydio:Pitch><drone-skydio:Yaw>146.5</drone-skydio:Yaw>"
            "</drone-skydio:CameraOrientationNED></rdf:Description>"), Gimbal(yaw=146.5, pitch=-84, roll=0.2), 22.5),
    (packet("Camera", PIX4D, 'Camera:Yaw="0/100" Camera:Pitch="0/100" Camera:Roll="0/100"/>'), None, None),
], ids=["Autel", "senseFly", "Autel's own", "Parrot", "Skydio", "a camera without angles"])
def test_other_makers_angles_and_heights(
    tmp_path: Path, written: bytes, gimbal: Gimbal | None, relative: float | None
) -> None:
    told = told_by(tmp_path, written)
    assert (told.gimbal, told.relative_altitude, told.xmp_fault) == (gimbal, relative, "")


def test_other_makers_places(tmp_path: Path) -> None:
    skydio = packet("drone-skydio", "https://www.skydio.com/drone-skydio/1.0/", 'drone-skydio:Latitude="37.5" '
                    'drone-skydio:Longitude="-122.25" drone-skydio:AbsoluteAltitude="41.5"/>')
    adobe = packet("exif", "http://ns.adobe.com/exif/1.0/", 'exif:GPSLatitude="37,30.0S" exif:GPSLongitude="122,15,0W" '
                   'exif:GPSAltitude="415/10" exif:GPSAltitudeRef="1"/>')
    for written, place in ((skydio, (37.5, -122.25, 41.5)), (adobe, (-37.5, -122.25, -41.5))):
        gps = told_by(tmp_path, written).gps
        assert gps is not None
        assert (gps.latitude, gps.longitude, gps.altitude) == place


@pytest.mark.parametrize("text", [
    b"<" * 10**6, b"<a:b " + b"a" * 10**6, b"<a:b " + b'a:b="' * 2 * 10**5, b"<!--" * 250_000, b"<a:b>" * 2 * 10**5,
    b"<a:b><rdf:li>x</rdf:li>" * 40_000,
])
def test_no_packet_takes_long(text: bytes) -> None:
    started = time.process_time()
    assert xmp.read(text).fault
    assert time.process_time() - started < 20
