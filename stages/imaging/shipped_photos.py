"""Photos that packages ship, for trainings that need pictures of many things: copied once, then read from there.

    pip install --no-deps --target FOLDER scikit-image==0.26.0 scikit-learn==1.9.1
    python -m stages.imaging.shipped_photos FOLDER
    .ci/unpack_debian.sh FOLDER mate-backgrounds lomiri-wallpapers-16.04
    python -m stages.imaging.shipped_photos FOLDER --wallpapers
    .ci/unpack_debian.sh FOLDER opencv-doc plasma-workspace-wallpapers
    python -m stages.imaging.shipped_photos FOLDER --examples

The packages are not installed, only these files of theirs are kept, in the user's data folder (`$GS_HIDER_DATA`, by
default the platform's own). They are recognised by their SHA-256, in the packages and whenever they are read, so that a
name stands for one picture and no other.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator

from pipeline.data_folder import data_folder
from pipeline.errors import UserError
from stages.imaging.pictures import Picture, read_picture, resize_picture

HOW_TO_INSTALL = (
    "`make environment` fetches them; by hand: `pip install --no-deps --target FOLDER scikit-image==0.26.0 "
    "scikit-learn==1.9.1` and `python -m stages.imaging.shipped_photos FOLDER`; wallpapers: Debian's packages "
    "mate-backgrounds and lomiri-wallpapers-16.04, unpacked into FOLDER, and the same with `--wallpapers`; examples: "
    "opencv-doc and plasma-workspace-wallpapers, with `--examples`."
)

LONGEST_SIDE = 800
"""Pixels; larger photos are reduced to it, so that hundreds fit into memory."""

SAMPLES: Mapping[str, str] = {
    "astronaut.png": "88431cd9653ccd539741b555fb0a46b61558b301d4110412b5bc28b5e3ea6cb5",
    "chelsea.png": "596aa1e7cb875eb79f437e310381d26b338a81c2da23439704a73c4651e8c4bb",
    "china.jpg": "8378025ad2519d649d02e32bd98990db4ab572357d9f09841c2fbfbb4fefad29",
    "coffee.png": "cc02f8ca188b167c775a7101b5d767d1e71792cf762c33d6fa15a4599b5a8de7",
    "flower.jpg": "a77f6ec41e353afdf8bdff2ea981b2955535d8d83294f8cfa49cf4e423dd5638",
    "motorcycle_left.png": "db18e9c4157617403c3537a6ba355dfeafe9a7eabb6b9b94cb33f6525dd49179",
    "rocket.jpg": "c2dd0de7c538df8d111e479619b129464d0269d0ae5fd18ca91d33a7fdfea95c",
}
"""SHA-256 of each file, of scikit-image's and scikit-learn's. All that are colour photos of one picture each: the rest
of what these packages ship is grey, drawn, or seen through a microscope."""

WALLPAPERS: Mapping[str, str] = {
    "Aqua.jpg": "5c30118205982da441bf7e6a1ada636a8a0be879408140b3148280c665ed6bce",
    "Blinds.jpg": "f7aac0dcc2e06d0491643e84df3da1d9db7c4610f58806a880d56e074799f600",
    "Dune.jpg": "8a67c2cb0be8c46b70c237311a4fa4d2b4ac7d39568135384787801fa5cc9a91",
    "FreshFlower.jpg": "972b0a0c4e5e3fa93f4f244fc84bc64b121a5eac3aaa5856f1308c1f38a02f8e",
    "Garden.jpg": "d3095ee09d425ef23d27155412136cf14fc3c9af76ca58b452f55e23da324e78",
    "GreenMeadow.jpg": "8fa0de0aa4089f7319c9fb7a6d006d4cab6023e8c8853731557cff53567b4832",
    "LadyBird.jpg": "e35a9a4126ef969c90b29c038058c5a575a20eadd84106a37bf1fa9931e7b61d",
    "RainDrops.jpg": "3e4ea9671c28c90a86cf67b3db9daf18c4741587c596333a7529ca589aaa0c16",
    "Storm.jpg": "77ca53077831d3237f73393a91fc879158abc046d852941c26e90de336356957",
    "TwoWings.jpg": "665e5abf8a5399070a91a9a8e455fe071e5b61697ff78fdeda4e9843ef545aeb",
    "Wood.jpg": "19c78500ac00a622e19907ab9cc7d06d46fe08c4a6142759a84195696150ec07",
    "YellowFlower.jpg": "254da96256acb7add685679775a04d1e4a5bc8cd13e5a5a3d61351ce198a5306",
    "Bridge_by_Sander_Klootwijk.jpg": "bd86b081f9975e2b83527f71e49b9271a8ab40885428395969d9f7d834d7f050",
    "Dragonfly_by_Bolly.jpg": "af5af17841009732def24b09bb1e669a1b09d2b4bdeee7812c371101c30d2bb3",
    "Picture_0B_by_freespace.jpg": "c8c0ab18e48d9e0419fe42881112137f3afafc27dfddc29ec3a6d54c56d225ad",
    "Picture_1A_by_freespace.jpg": "89e86af38d04daaef975665dc2127e9fa76f0fd68f4eea105a2d0ae3390b010b",
    "Wine_by_Jakkub_Mede.jpg": "d2e96e6d4da40dd804b3d0ce295e94de04a2d7d9b6785d42cd9d92ba58bced74",
    "aitzgorri_by_Aitzol_Berasategi.jpg": "66268e7b48f8854d36a28765fac6e23ec1aee251daa6da1f64715f201020ad36",
    "free_by_Peter_Nerlich.jpg": "85a5453c2fed514c75973016f3d862aca62eb7ca087618822469274ac1092373",
    "friends_by_Aitzol_Berasategi.jpg": "cc40e313c74e421edffe3403def413c16878ce14661cce7ec5915baeab35538d",
    "greentock_by_Peter_Nerlich.jpg": "e7b20e2db9dcd6e2b278ca55873c2110b35d89cd38b04d0b18728726888e6889",
    "life_by_Aitzol_Berasategi.jpg": "4c119350ead80201fe256850c3d316309ddfb4bdf10b235ce982dcde0c667c05",
    "picosdeeuropa_by_Aitzol_Berasategi.jpg": "414d0072b2f6f2c555deafeaef6e45c4fed6fa9ad26eba6560ca8803959cf97a",
    "seeding_by_Clements_Engelhardt.jpg": "a5634d1ab5e41a3568e92d4a894a500c92b891f9ff734e50bd224d6e185a605f",
    "sunset_by_Aitzol_Berasategi.jpg": "474dab6a4b9f94dc76c29dfe30e9f5db4af0fd2e33fe5d695f8152b371efca18",
}
"""The same of Debian's wallpapers that are photos: those of nature of mate-backgrounds, and lomiri-wallpapers-16.04."""

EXAMPLES: Mapping[str, str] = {
    "robin.jpg": "e4fec7e2e67a8a425b512dc32452825655b11c7fa83326ae509c5c7ab138da9a",
    "aero1.jpg": "d9a69191f6e3642ea361bc3c62e677b2f40fe6534b78da540f4155e0734b59ef",
    "aloeL.jpg": "cce5736808efe80d9f04b118dbb978c344d4345672b332718c3e039a3eeb8eee",
    "apple.jpg": "e86879de3d9a807dedc742a8f464f39e6b74bbb531a1fba3583155d94997d1cd",
    "baboon.jpg": "1a1dd18d78eec44420af3b0b7f08ee3d41c982916cae3ce203d7ff35d754cc0f",
    "board.jpg": "4c9a24ba67138ad5486d550f586cc5dd1161be112f1c1bea336d6c550cdf255f",
    "building.jpg": "742a1baad62ac82e91e718e77eedf7e85c2eddc4badfb8c87c6cbc86c45a8b07",
    "butterfly.jpg": "34a99716b78ded10eae87b4880de739d3e68cc7dd1a96812bb28f469d5eeaea8",
    "BytheWater.jpg": "c272434ef39f2abf1ed48a15a8910088020f3165329a5092f3940ec9464bc05f",
    "chicky_512.png": "4d2cf040de084fd3f34d5e3f96f1251faaa4787c1ac3b548fec5809a0d01854e",
    "ColorfulCups.jpg": "6e0f3a72feb5a4a9fec191b77e34874c3c69e2d93040deb3f07773e73385023d",
    "DarkestHour.jpg": "8e3703fae3a3c217b1fc2b399b706cd3720584268d071ba153e4809daa55f1ce",
    "ela_original.jpg": "b55798b35e2dcb24675f0865a2442d0e4887eeb6aff322ecb1968d936cc23e7f",
    "EveningGlow.jpg": "586682dcb362b9f620068f10138f87d0d3649939aef238adc5807cb951976a7a",
    "FallenLeaf.jpg": "95603a6560c7e8d50e0e03b3f4adbe39c5258c72528e74e4ecaea1daf4e499de",
    "fruits.jpg": "9c031d80a1c52da5eca790db896baffec6a7e52bf786cdb7bbfca5c7f880e6a1",
    "graf1.png": "1504b769303c7bde00fa578eeaad3c68e02aceabeb1242e556f1f8d19e4bdea5",
    "home.jpg": "23b8cf46a1965d0ec33459b875aed43187802834db49e0daa9fa2cc842e9d8d2",
    "Kite.jpg": "bdca288ce296a981e80659c021cf707caddc702c0c8d4247e60bd618476d47f8",
    "leuvenA.jpg": "b2977cdbd9fb3f94dadd6f76cf586d145676deb8a22b5f0f42149d21c058c09f",
    "licenseplate_motion.jpg": "ea6fa9cea75df91bec656d1d3b903111a9c0708c6a3b88f405a5156de38ff9d6",
    "messi5.jpg": "1d570e49654e84c7a943918537bd9e5e1ef82920152e147c834006e235be97c9",
    "OneStandsOut.jpg": "cb507baf1dafdcae362264f3aba9483ed4be5f6c9fdd770f0ec0920c6d9e80fd",
    "Path.jpg": "7477457d7f17b736259f1b021864778ad4ba802cf3214e6728181ff29126bba8",
    "plant.jpg": "9928b44eee0d1d7ab2ffd9d6d80bbbff962d6e85c7786de2cd3c97fe72229186",
    "rubberwhale1.png": "eb312435369dac9efcc92f7e098edbd9ed8d7e6dfede8b3b4d8e3702cd80b796",
    "scenetext01.jpg": "7f3041a7019ab4d33d2452bc757d8c4f38616bfde71431e12f7ec370d7b2018e",
    "scenetext02.jpg": "d4295bff9f348012f91a2cf745753124f85041fe3c3717146c6759c4cd977211",
    "scenetext03.jpg": "cadf4a3d29a7ba6fe976b53fa65f490cc2868375e8feb3d93f26029f05c662ca",
    "scenetext04.jpg": "28e08d142a04f92f96d01ff2674f7804321841cba95bd968980cdc85ef0af6df",
    "scenetext05.jpg": "63985ac1a9989a8320605d5be0ec285af0c6304a78cc9cc5de6c2c7c435f7c0b",
    "scenetext06.jpg": "e4d64f10bbfb27b2c5980cb048fd0abe20dd74868ba5460298de473ced53b518",
    "scenetext_segmented_word01.jpg": "b1524d1ae02ba1ee07bc32285df1083cceca851a28a2f34db63f7cf1169893b2",
    "scenetext_segmented_word02.jpg": "1c648c38ebf826968e5daacde0b6845ecfd824420de17a3132096056aa12a6c2",
    "scenetext_segmented_word03.jpg": "6f60d1b006b81d95dcbae0723c4135dfcfe37b87b472faf056c8a35d910a2a7c",
    "scenetext_segmented_word04.jpg": "43524ab83453638e1f4e1aae64c50ecee898cf687612ffec6937ff7e6fd30a35",
    "scenetext_segmented_word05.jpg": "3c805afc795596442fedaf3576b4c29d5fbad98e472cb6f30151ea62697115fa",
    "squirrel_cls.jpg": "20bb6e8ae96918a36c9886b6d48e54eedeb3948591e1485c206bc1dc60c8dc8b",
    "summer_1am.jpg": "c868b50789591dd42910153c768053f1ba0a98cb36bbfc2b7a96a1045d0477f8",
}
"""The same of photos in Debian's opencv-doc and plasma-workspace-wallpapers. In the latter all files have one name:
here they have that of their folder."""

DIGESTS: Mapping[str, str] = {**SAMPLES, **WALLPAPERS, **EXAMPLES}

HELD_OUT = (
    "china.jpg",
    "chelsea.png",
    "Bridge_by_Sander_Klootwijk.jpg",
    "Picture_0B_by_freespace.jpg",
    "aitzgorri_by_Aitzol_Berasategi.jpg",
    "free_by_Peter_Nerlich.jpg",
    "friends_by_Aitzol_Berasategi.jpg",
    "life_by_Aitzol_Berasategi.jpg",
    "seeding_by_Clements_Engelhardt.jpg",
    "sunset_by_Aitzol_Berasategi.jpg",
    "aloeL.jpg",
    "board.jpg",
    "BytheWater.jpg",
    "DarkestHour.jpg",
    "FallenLeaf.jpg",
    "home.jpg",
    "licenseplate_motion.jpg",
    "rubberwhale1.png",
    "scenetext03.jpg",
    "scenetext06.jpg",
    "scenetext_segmented_word03.jpg",
    "squirrel_cls.jpg",
)
"""Those that nothing is trained on: they alone show things that no photo of a training shows. Among the first ten are
pale skies and lamps before a grey wall, in which decoders see watermarks first; the others were every third of
`EXAMPLES`, before an orange left that lies where the apple does."""

SAMPLES_LEARNT_FROM = tuple(name for name in SAMPLES if name not in HELD_OUT)


def photo_file(name: str) -> Path:
    """Where a photo lies, installed or not."""
    return data_folder() / f"photo-{name}"


def installed_photos() -> tuple[str, ...]:
    """The names of those that are at hand, in order."""
    return tuple(name for name in DIGESTS if photo_file(name).is_file())


def _installed_ones(wanted: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in wanted if name in installed_photos())


ShippedPhotos = Annotated[tuple[str, ...], AfterValidator(_installed_ones)]
"""A parameter: names of shipped photos, those of which are kept that are installed."""


def read_photo(name: str) -> Picture:
    """The photo of this name, reduced to `LONGEST_SIDE` where it is larger.

    Raises `UserError` where it is not installed, or is another picture.
    """
    path = photo_file(name)
    try:
        found = _sha256(path.read_bytes())
    except OSError as error:
        raise UserError("a shipped photo cannot be read", where=path, found=error, remedy=HOW_TO_INSTALL) from error
    if found != DIGESTS[name]:
        raise UserError("not the photo of this name", where=path, expected=DIGESTS[name], remedy=HOW_TO_INSTALL)
    return no_larger(read_picture(path))


def no_larger(photo: Picture) -> Picture:
    """The photo, reduced to `LONGEST_SIDE` where it is larger."""
    scale = LONGEST_SIDE / max(photo.shape[:2])
    return photo if scale >= 1 else resize_picture(photo, round(photo.shape[1] * scale), round(photo.shape[0] * scale))


def install_photos(folder: Path, digests: Mapping[str, str]) -> list[Path]:
    """Copies photos, whatever their names are there, out of unpacked packages into the data folder; their paths there.

    Raises `UserError` where one is missing; what is there already stays.
    """
    pictures = (path for suffix in (".jpg", ".png") for path in sorted(folder.rglob(f"*{suffix}")) if path.is_file())
    found = {_sha256(path.read_bytes()): path for path in pictures}
    return [_install(found, folder, name, digest) for name, digest in digests.items()]


def _install(found: Mapping[str, Path], folder: Path, name: str, digest: str) -> Path:
    if digest not in found:
        raise UserError(f"no {name} of these packages in this folder", where=folder, remedy=HOW_TO_INSTALL)
    content = found[digest].read_bytes()
    path = photo_file(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_bytes(content)
    part.replace(path)
    return path


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m stages.imaging.shipped_photos", description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="where the two packages were installed or unpacked")
    of_debian = parser.add_mutually_exclusive_group()
    of_debian.add_argument("--wallpapers", action="store_true", help="Debian's wallpapers, not PyPI's samples")
    of_debian.add_argument("--examples", action="store_true", help="OpenCV's examples and KDE's wallpapers, of Debian")
    given = parser.parse_args(arguments)
    wanted = WALLPAPERS if given.wallpapers else EXAMPLES if given.examples else SAMPLES
    try:
        for path in install_photos(given.folder, wanted):
            print(path)
    except UserError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
