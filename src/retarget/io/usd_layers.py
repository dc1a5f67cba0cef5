"""Opening a USD stage without leaving its folder. Runs in the child.

USD fetches what a layer refers to by itself: sublayers, references, payloads, value clips, each of them again. So the
layers are walked first, one by one and without composing them, and a stage is opened only if all of them lie in the
folder of the file (in the package, for a .usdz). Missing ones are noted; USD composes without them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from typing import Any

from retarget.io.child import Refused
from retarget.io.pictures import is_inside

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MOST_LAYERS = 2000
MOST_PRIMS = 500_000
"""Prims of a composed stage; references to references can multiply them without end."""


def in_plain_words(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What the work returns; errors of usd-core without the places in its own source. Raises `ValueError` for them."""
    from pxr import Tf

    try:
        return work()
    except Tf.ErrorException as error:
        try:
            text = str(error)
        except UnicodeDecodeError:  # it quotes what is no text
            raise ValueError("it holds bytes that are no text where text is expected") from None
        told = re.findall(r" : '(.*?)'\s*(?=Error in |$)", text, re.DOTALL)
        raise ValueError(re.sub(r"\S*/(?=[^/\s]+:\d)", "", told[-1]) if told else text) from None


def open_stage(source: str) -> tuple[Any, list[str], bool]:
    """The composed stage, notes, and whether it has other layers than its own. Raises `Refused`."""
    from pxr import Usd

    missing, composed = check_layers(source)
    stage = Usd.Stage.Open(source, Usd.Stage.LoadAll)
    if stage is None:
        raise ValueError("no stage opens")
    notes = [f"{len(missing)} layers are missing: {', '.join(map(repr, missing[:3]))}"] if missing else []
    return stage, notes, composed


def home_of(source: str) -> str:
    """What a file may reach: the real path of its folder; for a package the package itself."""
    return os.path.realpath(source if source.lower().endswith(".usdz") else os.path.dirname(source))


def size_within(source: str) -> int:
    """Bytes of all USD files that a file may reach, itself among them."""
    home = home_of(source)
    if os.path.isfile(home):
        return os.path.getsize(home)
    found = 0
    for number, (folder, _, names) in enumerate(os.walk(home)):
        paths = [os.path.join(folder, name) for name in names if name.lower().endswith(SUFFIXES)]
        found += sum(os.path.getsize(path) for path in paths if os.path.isfile(path))
        if number == MOST_LAYERS:
            break
    return found


def check_layers(source: str) -> tuple[list[str], bool]:
    """Missing layers of all that the file refers to, and whether it refers to any. Raises `Refused` for one outside."""
    from pxr import Sdf

    root = Sdf.Layer.FindOrOpen(source)
    if root is None:
        raise ValueError("it holds no layer")
    home = home_of(source)
    waiting, seen, missing = [root], {root.identifier}, []
    while waiting:
        layer = waiting.pop()
        _refuse_value_clips(layer)
        for asset in sorted(set(layer.GetCompositionAssetDependencies())):
            if not asset:
                continue
            place = _place(layer, asset, home)
            if place is None:
                missing.append(asset)
                continue
            below = Sdf.Layer.FindOrOpen(place)
            if below is None:
                raise Refused(f"refers to {asset!r}, which cannot be read as USD")
            if below.identifier not in seen:
                seen.add(below.identifier)
                waiting.append(below)
        if len(seen) > MOST_LAYERS:
            raise Refused(f"refers to more than {MOST_LAYERS} layers")
    return missing, len(seen) > 1


def neighbours(source: str) -> list[str]:
    """Real paths of the files in the source's folder that its layers refer to (layers, pictures, sounds), there or not; after
    `check_layers`. A package has none."""
    from pxr import Tf, UsdUtils

    home = home_of(source)
    if home == os.path.realpath(source):
        return []
    own = os.path.join(home, os.path.basename(source))
    waiting, found = [own], set()
    while waiting:
        layer = waiting.pop()
        try:
            named = UsdUtils.ExtractExternalReferences(layer)
        except Tf.ErrorException:  # no part of the stage, or that had been refused
            continue
        for asset in (each for kind in named for each in kind):
            real = os.path.realpath(os.path.join(os.path.dirname(layer), asset.partition("[")[0]))
            if asset and is_inside(real, home) and real not in found | {own, home}:
                found.add(real)
                if real.lower().endswith((".usd", ".usda", ".usdc")) and os.path.isfile(real):
                    waiting.append(real)
    return sorted(found)


def _place(layer: Any, asset: str, home: str) -> str | None:
    """Where a layer lies that another refers to; None if nowhere. Raises `Refused` for any place outside `home`."""
    from pxr import Ar, Sdf

    outside = Refused(
        f"refers to {asset!r}, which is not inside its folder; put the file there, or export one file that holds all"
    )
    if asset.startswith("`") or "://" in asset or Sdf.Layer.IsAnonymousLayerIdentifier(asset):
        raise outside
    plain, arguments = Sdf.Layer.SplitIdentifier(asset)
    if arguments:
        raise outside
    place = Sdf.ComputeAssetPathRelativeToLayer(layer, plain)
    outer, inner = Ar.SplitPackageRelativePathOuter(place) if Ar.IsPackageRelativePath(place) else (place, "")
    if not os.path.isabs(outer):  # not beside the layer; USD would go and look elsewhere
        if os.path.normpath(plain).startswith(("..", "/")):
            raise outside
        return None
    real = os.path.realpath(outer)
    if not is_inside(real, home):
        raise outside
    if not (inner or outer).lower().endswith(SUFFIXES) or not outer.lower().endswith(SUFFIXES):
        raise Refused(f"refers to {asset!r}, which is no USD file")
    found = bool(Ar.GetResolver().Resolve(place)) if inner else os.path.isfile(real)
    return place if found else None


def _refuse_value_clips(layer: Any) -> None:
    from pxr import Sdf

    def visit(path: Any) -> None:
        if not (path.IsPrimPath() or path.IsPrimVariantSelectionPath()):
            return
        if layer.GetObjectAtPath(path).HasInfo("clips"):
            raise Refused(f"{path} takes its animation from value clips, which are not read; export it in one file")

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)


def prims_of(stage: Any) -> list[Any]:
    """All prims that are there and shown, those inside instances too. Raises `Refused` for more than can be meant."""
    from pxr import Usd

    found = []
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        found.append(prim)
        if len(found) > MOST_PRIMS:
            raise Refused(f"has more than {MOST_PRIMS} prims")
    return found
