"""What usd-core's own skinning says of a file: joints and points of every frame in metres with +Y up."""

import numpy as np


def posed_by_usd(path, code):
    """World joints (joints, 3) by name and world points of all skinned meshes in order, at a time code."""
    from pxr import Gf, Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(path))
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    z_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    cache = UsdSkel.Cache()
    joints, points = {}, []
    for root in [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)]:
        cache.Populate(UsdSkel.Root(root), Usd.PrimDefaultPredicate)
        for binding in cache.ComputeSkelBindings(UsdSkel.Root(root), Usd.PrimDefaultPredicate):
            skeleton = cache.GetSkelQuery(binding.GetSkeleton())
            placed = UsdGeom.XformCache(code).GetLocalToWorldTransform(skeleton.GetPrim())
            for token, matrix in zip(skeleton.GetJointOrder(), skeleton.ComputeJointSkelTransforms(code)):
                joints[token.rsplit("/", 1)[-1]] = np.array((matrix * placed).ExtractTranslation())
            for target in binding.GetSkinningTargets():
                skinned = UsdGeom.Mesh(target.GetPrim()).GetPointsAttr().Get(code)
                transforms = skeleton.ComputeSkinningTransforms(code)
                assert target.ComputeSkinnedPoints(transforms, skinned, code)
                points += [np.array(placed.Transform(Gf.Vec3d(point))) for point in skinned]
    turned = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float) if z_up else np.eye(3)
    place = lambda rows: unit * np.array(rows, float).reshape(-1, 3) @ turned.T  # noqa: E731
    return dict(zip(joints, place(list(joints.values())))), place(points)
