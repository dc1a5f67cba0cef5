"""A new USD stage for a character that came from elsewhere: SkelRoot, skeleton, mesh, materials. Runs in the child."""

from __future__ import annotations

from typing import Any

import numpy as np

from retarget.io.usd_assets import Assets

PICTURES = {b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpg"}


def make_stage(order: dict[str, Any], arrays: dict[str, np.ndarray], assets: Assets) -> Any:
    """The stage, in metres with +Y up. Sets `order["skeleton"]`, the path of the skeleton."""
    from pxr import Usd, UsdGeom, UsdSkel, Vt

    stage = Usd.Stage.CreateInMemory(".usda")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdSkel.Root.Define(stage, f"/{order['name']}")
    Usd.ModelAPI(root.GetPrim()).SetKind("component")
    stage.SetDefaultPrim(root.GetPrim())
    skeleton = UsdSkel.Skeleton.Define(stage, root.GetPath().AppendChild("Skeleton"))
    order["skeleton"] = str(skeleton.GetPath())
    tokens, names = order["tokens"], order["names"]
    skeleton.CreateJointsAttr(Vt.TokenArray(tokens))
    if names != [token.rsplit("/", 1)[-1] for token in tokens]:
        skeleton.CreateJointNamesAttr(Vt.TokenArray(names))
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(arrays["bind"])))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(arrays["rest"])))
    if "points" in arrays:
        _add_mesh(stage, root, skeleton, order, arrays, assets)
    return stage


def _add_mesh(
    stage: Any, root: Any, skeleton: Any, order: dict[str, Any], arrays: dict[str, np.ndarray], assets: Assets
) -> None:
    """The surface, bound to the skeleton."""
    from pxr import Gf, UsdGeom, UsdSkel, Vt

    mesh = add_surface(stage, root, "Body", order, arrays, assets)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(arrays["normals"]))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    binding, width = UsdSkel.BindingAPI.Apply(mesh.GetPrim()), arrays["joints"].shape[1]
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    joints, weights = (np.ascontiguousarray(arrays[name].ravel()) for name in ("joints", "weights"))
    binding.CreateJointIndicesPrimvar(False, width).Set(Vt.IntArray.FromNumpy(joints))
    binding.CreateJointWeightsPrimvar(False, width).Set(Vt.FloatArray.FromNumpy(weights))


def add_surface(
    stage: Any, root: Any, name: str, order: dict[str, Any], arrays: dict[str, np.ndarray], assets: Assets
) -> Any:
    """A mesh below `root`: points, faces, texture coordinates, and materials in a scope beside it."""
    from pxr import Sdf, UsdGeom, UsdShade, Vt

    mesh = UsdGeom.Mesh.Define(stage, root.GetPath().AppendChild(name))
    points, faces = arrays["points"], arrays["faces"]
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.ravel())))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)])))
    mesh.CreateDoubleSidedAttr(any(material["double_sided"] for material in order["materials"]))
    if "uvs" in arrays:
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        uvs = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, UsdGeom.Tokens.vertex)
        uvs.Set(Vt.Vec2fArray.FromNumpy(arrays["uvs"]))
    scope = UsdGeom.Scope.Define(stage, root.GetPath().AppendChild("Materials"))
    used = np.unique(arrays["face_materials"]).tolist()
    for number in used:
        picture = arrays.get(f"picture_{number}") if "uvs" in arrays else None
        look = _add_material(stage, scope, order["materials"][number], picture, assets)
        shown = mesh.GetPrim()
        if len(used) > 1:
            own = np.flatnonzero(arrays["face_materials"] == number).astype(np.int32)
            api = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
            shown = api.CreateMaterialBindSubset(look.GetPrim().GetName(), Vt.IntArray.FromNumpy(own)).GetPrim()
        UsdShade.MaterialBindingAPI.Apply(shown).Bind(look)
    return mesh


def _add_material(
    stage: Any, scope: Any, material: dict[str, Any], picture: np.ndarray | None, assets: Assets
) -> Any:
    """A UsdPreviewSurface of the base colour; with the picture, where it goes into a package."""
    from pxr import Gf, Sdf, UsdShade

    free, count = material["name"], 2
    while stage.GetPrimAtPath(scope.GetPath().AppendChild(free)):
        free, count = f"{material['name']}_{count}", count + 1
    look = UsdShade.Material.Define(stage, scope.GetPath().AppendChild(free))
    shader = UsdShade.Shader.Define(stage, look.GetPath().AppendChild("Surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    *color, alpha = material["color"]
    diffuse = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    diffuse.Set(Gf.Vec3f(*color))
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.8)
    shader.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    if alpha < 1:
        shader.CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(alpha)
    look.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    data = picture.tobytes() if picture is not None else b""
    kind = next((suffix for head, suffix in PICTURES.items() if data.startswith(head)), None)
    if kind is not None and assets.packed:
        file = next((name for name, known in assets.files.items() if known == data), None)
        file = file or assets.add(f"textures/{len(assets.files)}_{free}.{kind}", data)
        reader = UsdShade.Shader.Define(stage, look.GetPath().AppendChild("Coordinates"))
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        texture = UsdShade.Shader.Define(stage, look.GetPath().AppendChild("Picture"))
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(file))
        texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
        texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*color, alpha))
        for axis in ("wrapS", "wrapT"):
            texture.CreateInput(axis, Sdf.ValueTypeNames.Token).Set("repeat")
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
            reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        )
        diffuse.ConnectToSource(texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3))
    return look
