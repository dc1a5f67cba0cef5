"""What names say, one by one."""

import pytest

from retarget.correspond.joints_by_name import part_scores, score_names, shared_prefix, spell


@pytest.mark.parametrize(
    "name, part, side",
    [
        ("mixamorig:LeftForeArm", "LowerArm", 1),
        ("mixamorig1:RightUpLeg", "UpperLeg", -1),
        ("Armature|upperarm_l", "UpperArm", 1),
        ("DEF-shin.R", "LowerLeg", -1),
        ("ORG-upper_arm.L", "UpperArm", 1),
        ("J_Bip_L_UpperArm", "UpperArm", 1),
        ("CC_Base_R_Calf", "LowerLeg", -1),
        ("ValveBiped.Bip01_L_Hand", "Hand", 1),
        ("Bip01 R Thigh", "UpperLeg", -1),
        ("lShldrBend", "UpperArm", 1),
        ("rThigh", "UpperLeg", -1),
        ("thighFBXASC046L", "UpperLeg", 1),
        ("left_hip", "UpperLeg", 1),
        ("L_Ankle", "Foot", 1),
        ("ElbowRight", "LowerArm", -1),
        ("lthumb", "Thumb", 1),
        ("f_index.01.L", "Index", 1),
        ("LeftHandPinky2", "Little", 1),
        ("LFArm", "LowerArm", 1),
        ("RUArm", "UpperArm", -1),
        ("LThigh", "UpperLeg", 1),
        ("左ひじ", "LowerArm", 1),
        ("右足首", "Foot", -1),
        ("Fuß_links", "Foot", 1),
        ("épaule droite", "Shoulder", -1),
        ("Oberschenkel_rechts", "UpperLeg", -1),
        ("spine_01", "spine", 0),
        ("Head", "head", 0),
        ("tête", "head", 0),
        ("Hips", "hips", 0),
        ("pelvis", "hips", 0),
    ],
)
def test_part_and_side(name, part, side):
    spelling = spell(name)
    scores = part_scores(spelling)
    assert spelling.side == side
    assert scores and max(scores, key=scores.get) == part and scores[part] >= 0.6


@pytest.mark.parametrize("name", ["IK-foot.l", "Head_end", "control-toe-roll.l", "HeadNub", "skirt_L_01", "Toe_End.L"])
def test_helpers_are_no_parts(name):
    assert spell(name).auxiliary
    assert max(part_scores(spell(name)).values(), default=0.0) < 0.3


@pytest.mark.parametrize("name", ["upperarm_twist_01_l", "lForearmTwist", "LeftUpLegRoll"])
def test_twists_are_told_from_their_limbs(name):
    assert spell(name).twist
    assert max(part_scores(spell(name)).values(), default=0.0) < 0.3


@pytest.mark.parametrize("name", ["lower", "leg", "ring", "reel", "Rig", "Lip"])
def test_no_side_is_read_into_a_word(name):
    assert spell(name).side == 0


def test_a_shared_prefix_says_nothing():
    names = ("Hero_Hips", "Hero_LeftArm", "Hero_Head")
    assert shared_prefix(names) == ("hero",)
    assert score_names(names).parts["head"].tolist() == [0.0, 0.0, 1.0]


def test_the_wrist_is_the_hand_where_joints_are_named_and_a_helper_where_bones_are():
    joints = score_names(("left_elbow", "left_wrist", "left_hand"))
    bones = score_names(("lowerarm.l", "wrist.l", "hand.l"))
    alone = score_names(("lowerarm.l", "wrist.l"))
    assert joints.parts["Hand"][1] > 0.8 > 0.3 > joints.parts["Hand"][2]
    assert bones.parts["Hand"][2] > 0.8 > 0.3 > bones.parts["Hand"][1]
    assert alone.parts["Hand"][1] > 0.8
