"""Skeletons as people's rigs have them, built from name tables and one generic human, and animals that are none.

A rig is an indented outline. `name @place =canonical`: the place is a key of `PLACES` or 'a~b~0.5' (between two), the
canonical name (without side) is the truth. Braces hold the two spellings of a side: '{Left|Right}Arm'.
"""

from __future__ import annotations

import re

import numpy as np

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.character import Skeleton

# A standing human of 1.75 m in a T pose, metres, Y up, facing +Z; the left side.
PLACES = {
    "ground": (0, 0, 0),
    "hips": (0, 0.95, 0),
    "pelvis": (0, 0.93, 0.0),
    "waist": (0, 1.02, -0.01),
    "spine": (0, 1.06, -0.01),
    "spine2": (0, 1.14, -0.02),
    "chest": (0, 1.22, -0.03),
    "chest2": (0, 1.3, -0.03),
    "upperChest": (0, 1.36, -0.03),
    "neck": (0, 1.48, -0.02),
    "neck2": (0, 1.53, -0.01),
    "head": (0, 1.58, 0.0),
    "headTop": (0, 1.76, 0.0),
    "eye": (0.032, 1.65, 0.08),
    "jaw": (0, 1.6, 0.03),
    "jawTip": (0, 1.56, 0.09),
    "breast": (0.08, 1.28, 0.1),
    "clavicle": (0.03, 1.43, 0.0),
    "upperArm": (0.17, 1.44, -0.02),
    "lowerArm": (0.44, 1.44, -0.03),
    "hand": (0.68, 1.44, -0.02),
    "upperLeg": (0.09, 0.9, 0.0),
    "lowerLeg": (0.095, 0.5, 0.012),
    "foot": (0.1, 0.08, -0.025),
    "toes": (0.11, 0.02, 0.09),
    "toeEnd": (0.11, 0.02, 0.16),
    "heel": (0.1, 0.0, -0.06),
    "buttock": (0.08, 0.93, -0.01),
    "hair1": (0.0, 1.72, -0.08),
    "hair2": (0.0, 1.6, -0.14),
    "hair3": (0.0, 1.45, -0.16),
    "hair4": (0.0, 1.25, -0.16),
    "tail1": (0.1, 1.7, -0.06),
    "tail2": (0.16, 1.5, -0.1),
    "tail3": (0.17, 1.25, -0.1),
    "tail4": (0.17, 1.0, -0.1),
    "skirt1": (0.1, 0.92, 0.1),
    "skirt2": (0.13, 0.72, 0.13),
    "skirt3": (0.15, 0.55, 0.15),
    "skirt4": (0.16, 0.45, 0.16),
    "pole": (0.1, 0.5, 0.6),
}
FINGER_ROWS = {"Thumb": None, "Index": 0.03, "Middle": 0.008, "Ring": -0.014, "Little": -0.035}
for _finger, _z in FINGER_ROWS.items():
    if _finger == "Thumb":
        _chain = [(0.7, 1.425, 0.02), (0.73, 1.415, 0.05), (0.755, 1.41, 0.07), (0.78, 1.41, 0.085)]
    else:
        _far = {"Index": 0.0, "Middle": 0.005, "Ring": 0.0, "Little": -0.012}[_finger]
        _chain = [(0.77 + _far + step, 1.44, _z - 0.02) for step in (0.0, 0.04, 0.065, 0.085)]
        PLACES[f"{_finger}0"] = (0.705, 1.44, 0.4 * _z - 0.02)
    for _n, _place in enumerate(_chain, 1):
        PLACES[f"{_finger}{_n}"] = _place

FINGERS = dict(Thumb="Thumb", Index="Index", Middle="Middle", Ring="Ring", Little="Little")


def fingers(indent: int, pattern: str, count: int = 3, names: dict[str, str] | None = None, palms: str = "") -> str:
    """Outline lines of a hand: `pattern` has N for the finger's name and # for the joint's number."""
    lines = []
    for finger, name in (names or FINGERS).items():
        bones = ("Metacarpal", "Proximal", "Distal") if finger == "Thumb" else ("Proximal", "Intermediate", "Distal")
        depth = indent
        if palms and finger != "Thumb":
            lines.append(" " * depth + palms.replace("N", name) + f" @{finger}0")
            depth += 1
        for n in range(1, count + 1):
            truth = f" ={finger}{bones[n - 1]}" if n <= 3 else ""
            lines.append(" " * depth + pattern.replace("N", name).replace("#", str(n)) + f" @{finger}{n}{truth}")
            depth += 1
    return "\n".join(lines)


RIGS: dict[str, str] = {}

RIGS["mixamo"] = f"""
mixamorig:Hips @hips =hips
 mixamorig:Spine @spine =spine
  mixamorig:Spine1 @chest =chest
   mixamorig:Spine2 @upperChest =upperChest
    mixamorig:Neck @neck =neck
     mixamorig:Head @head =head
      mixamorig:HeadTop_End @headTop
    mixamorig:{{Left|Right}}Shoulder @clavicle =Shoulder
     mixamorig:{{Left|Right}}Arm @upperArm =UpperArm
      mixamorig:{{Left|Right}}ForeArm @lowerArm =LowerArm
       mixamorig:{{Left|Right}}Hand @hand =Hand
{fingers(8, "mixamorig:{Left|Right}HandN#", 4, FINGERS | dict(Little="Pinky"))}
 mixamorig:{{Left|Right}}UpLeg @upperLeg =UpperLeg
  mixamorig:{{Left|Right}}Leg @lowerLeg =LowerLeg
   mixamorig:{{Left|Right}}Foot @foot =Foot
    mixamorig:{{Left|Right}}ToeBase @toes =Toes
     mixamorig:{{Left|Right}}Toe_End @toeEnd
"""
RIGS["ready player me"] = (
    RIGS["mixamo"]
    .replace("mixamorig:", "")
    .replace("      HeadTop_End @headTop", "      HeadTop_End @headTop\n      {Left|Right}Eye @eye =Eye")
)

_small = {key: name.lower() for key, name in (FINGERS | dict(Little="pinky")).items()}
_unreal_hand = fingers(11, "N_0#_{l|r}", 3, _small, "N_metacarpal_{l|r}")
RIGS["unreal 5"] = f"""
root @ground
 pelvis @hips =hips
  spine_01 @waist =spine
   spine_02 @spine
    spine_03 @spine2 =chest
     spine_04 @chest
      spine_05 @upperChest =upperChest
       clavicle_{{l|r}} @clavicle =Shoulder
        upperarm_{{l|r}} @upperArm =UpperArm
         upperarm_twist_01_{{l|r}} @upperArm~lowerArm~0.33
         upperarm_twist_02_{{l|r}} @upperArm~lowerArm~0.66
         upperarm_correctiveRoot_{{l|r}} @upperArm
          upperarm_bck_{{l|r}} @upperArm
         lowerarm_{{l|r}} @lowerArm =LowerArm
          lowerarm_twist_02_{{l|r}} @lowerArm~hand~0.33
          lowerarm_twist_01_{{l|r}} @lowerArm~hand~0.66
          hand_{{l|r}} @hand =Hand
{_unreal_hand}
       neck_01 @neck =neck
        neck_02 @neck2
         head @head =head
  thigh_{{l|r}} @upperLeg =UpperLeg
   thigh_twist_01_{{l|r}} @upperLeg~lowerLeg~0.33
   calf_{{l|r}} @lowerLeg =LowerLeg
    calf_twist_01_{{l|r}} @lowerLeg~foot~0.66
    foot_{{l|r}} @foot =Foot
     ball_{{l|r}} @toes =Toes
 ik_foot_root @ground
  ik_foot_{{l|r}} @foot
 ik_hand_root @ground
  ik_hand_gun @hand
   ik_hand_{{l|r}} @hand
 interaction @ground
 center_of_mass @ground
"""
_rigify_hand = fingers(
    11, "DEF-N.0#.{L|R}", 3, dict(Thumb="thumb", Index="f_index", Middle="f_middle", Ring="f_ring", Little="f_pinky")
)
RIGS["rigify deform"] = f"""
root @ground
 DEF-spine @hips =hips
  DEF-pelvis.{{L|R}} @hips
  DEF-thigh.{{L|R}} @upperLeg =UpperLeg
   DEF-thigh.{{L|R}}.001 @upperLeg~lowerLeg~0.5
    DEF-shin.{{L|R}} @lowerLeg =LowerLeg
     DEF-shin.{{L|R}}.001 @lowerLeg~foot~0.5
      DEF-foot.{{L|R}} @foot =Foot
       DEF-toe.{{L|R}} @toes =Toes
  DEF-spine.001 @spine =spine
   DEF-spine.002 @chest =chest
    DEF-spine.003 @upperChest =upperChest
     DEF-spine.004 @neck =neck
      DEF-spine.005 @neck2
       DEF-spine.006 @head =head
     DEF-breast.{{L|R}} @breast
     DEF-shoulder.{{L|R}} @clavicle =Shoulder
      DEF-upper_arm.{{L|R}} @upperArm =UpperArm
       DEF-upper_arm.{{L|R}}.001 @upperArm~lowerArm~0.5
        DEF-forearm.{{L|R}} @lowerArm =LowerArm
         DEF-forearm.{{L|R}}.001 @lowerArm~hand~0.5
          DEF-hand.{{L|R}} @hand =Hand
{_rigify_hand}
"""
RIGS["metarig"] = """
spine @hips =hips
 spine.001 @spine =spine
  spine.002 @chest =chest
   spine.003 @upperChest =upperChest
    spine.004 @neck =neck
     spine.005 @neck2
      spine.006 @head =head
    shoulder.{L|R} @clavicle =Shoulder
     upper_arm.{L|R} @upperArm =UpperArm
      forearm.{L|R} @lowerArm =LowerArm
       hand.{L|R} @hand =Hand
    breast.{L|R} @breast
 pelvis.{L|R} @hips
 thigh.{L|R} @upperLeg =UpperLeg
  shin.{L|R} @lowerLeg =LowerLeg
   foot.{L|R} @foot =Foot
    toe.{L|R} @toes =Toes
    heel.02.{L|R} @heel
"""
RIGS["biped"] = """
Bip01 @hips
 Bip01 Footsteps @ground
 Bip01 Pelvis @hips =hips
  Bip01 Spine @waist =spine
   Bip01 {L|R} Thigh @upperLeg =UpperLeg
    Bip01 {L|R} Calf @lowerLeg =LowerLeg
     Bip01 {L|R} Foot @foot =Foot
      Bip01 {L|R} Toe0 @toes =Toes
       Bip01 {L|R} Toe0Nub @toeEnd
   Bip01 Spine1 @chest =chest
    Bip01 Spine2 @upperChest
     Bip01 Neck @neck =neck
      Bip01 {L|R} Clavicle @clavicle =Shoulder
       Bip01 {L|R} UpperArm @upperArm =UpperArm
        Bip01 {L|R} Forearm @lowerArm =LowerArm
         Bip01 {L|R} Hand @hand =Hand
          Bip01 {L|R} Finger0 @Thumb1 =ThumbMetacarpal
           Bip01 {L|R} Finger01 @Thumb2 =ThumbProximal
            Bip01 {L|R} Finger02 @Thumb3 =ThumbDistal
          Bip01 {L|R} Finger1 @Index1 =IndexProximal
           Bip01 {L|R} Finger11 @Index2 =IndexIntermediate
            Bip01 {L|R} Finger12 @Index3 =IndexDistal
          Bip01 {L|R} Finger2 @Middle1 =MiddleProximal
           Bip01 {L|R} Finger21 @Middle2 =MiddleIntermediate
            Bip01 {L|R} Finger22 @Middle3 =MiddleDistal
      Bip01 Head @head =head
       Bip01 HeadNub @headTop
       Bip01 Ponytail1 @hair1
        Bip01 Ponytail11 @hair2
         Bip01 Ponytail12 @hair3
"""
RIGS["valve biped"] = """
ValveBiped.Bip01_Pelvis @hips =hips
 ValveBiped.Bip01_Spine @waist =spine
  ValveBiped.Bip01_Spine1 @spine
   ValveBiped.Bip01_Spine2 @chest =chest
    ValveBiped.Bip01_Spine4 @upperChest =upperChest
     ValveBiped.Bip01_Neck1 @neck =neck
      ValveBiped.Bip01_Head1 @head =head
     ValveBiped.Bip01_{L|R}_Clavicle @clavicle =Shoulder
      ValveBiped.Bip01_{L|R}_UpperArm @upperArm =UpperArm
       ValveBiped.Bip01_{L|R}_Forearm @lowerArm =LowerArm
        ValveBiped.Bip01_{L|R}_Hand @hand =Hand
 ValveBiped.Bip01_{L|R}_Thigh @upperLeg =UpperLeg
  ValveBiped.Bip01_{L|R}_Calf @lowerLeg =LowerLeg
   ValveBiped.Bip01_{L|R}_Foot @foot =Foot
    ValveBiped.Bip01_{L|R}_Toe0 @toes =Toes
"""
RIGS["daz genesis 8"] = f"""
hip @hips =hips
 pelvis @pelvis
  {{l|r}}ThighBend @upperLeg =UpperLeg
   {{l|r}}ThighTwist @upperLeg~lowerLeg~0.5
    {{l|r}}Shin @lowerLeg =LowerLeg
     {{l|r}}Foot @foot =Foot
      {{l|r}}Metatarsals @foot~toes~0.5
       {{l|r}}Toe @toes
        {{l|r}}BigToe @toeEnd
 abdomenLower @waist =spine
  abdomenUpper @spine2
   chestLower @chest =chest
    {{l|r}}Pectoral @breast
    chestUpper @upperChest =upperChest
     {{l|r}}Collar @clavicle =Shoulder
      {{l|r}}ShldrBend @upperArm =UpperArm
       {{l|r}}ShldrTwist @upperArm~lowerArm~0.5
        {{l|r}}ForearmBend @lowerArm =LowerArm
         {{l|r}}ForearmTwist @lowerArm~hand~0.5
          {{l|r}}Hand @hand =Hand
{fingers(11, "{l|r}N#", 3, FINGERS | dict(Middle="Mid", Little="Pinky"), "{l|r}CarpalN")}
     neckLower @neck =neck
      neckUpper @neck2
       head @head =head
        upperTeeth @jaw
        lowerJaw @jaw =jaw
         lowerTeeth @jawTip
         tongue01 @jaw~jawTip~0.3
          tongue02 @jaw~jawTip~0.7
        {{l|r}}Eye @eye =Eye
"""
RIGS["reallusion"] = """
CC_Base_BoneRoot @ground
 CC_Base_Hip @hips =hips
  CC_Base_Pelvis @hips
   CC_Base_{L|R}_Thigh @upperLeg =UpperLeg
    CC_Base_{L|R}_ThighTwist01 @upperLeg~lowerLeg~0.3
    CC_Base_{L|R}_ThighTwist02 @upperLeg~lowerLeg~0.6
    CC_Base_{L|R}_Calf @lowerLeg =LowerLeg
     CC_Base_{L|R}_CalfTwist01 @lowerLeg~foot~0.3
     CC_Base_{L|R}_KneeShareBone @lowerLeg
     CC_Base_{L|R}_Foot @foot =Foot
      CC_Base_{L|R}_ToeBaseShareBone @toes
      CC_Base_{L|R}_ToeBase @toes =Toes
  CC_Base_Waist @waist =spine
   CC_Base_Spine01 @spine2 =chest
    CC_Base_Spine02 @chest2 =upperChest
     CC_Base_NeckTwist01 @neck =neck
      CC_Base_NeckTwist02 @neck2
       CC_Base_Head @head =head
        CC_Base_FacialBone @head
         CC_Base_JawRoot @jaw =jaw
         CC_Base_{L|R}_Eye @eye =Eye
     CC_Base_{L|R}_Clavicle @clavicle =Shoulder
      CC_Base_{L|R}_Upperarm @upperArm =UpperArm
       CC_Base_{L|R}_UpperarmTwist01 @upperArm~lowerArm~0.3
       CC_Base_{L|R}_Forearm @lowerArm =LowerArm
        CC_Base_{L|R}_ForearmTwist01 @lowerArm~hand~0.3
        CC_Base_{L|R}_ElbowShareBone @lowerArm
        CC_Base_{L|R}_Hand @hand =Hand
     CC_Base_{L|R}_Breast @breast
"""
RIGS["smpl"] = """
pelvis @hips =hips
 {left|right}_hip @upperLeg =UpperLeg
  {left|right}_knee @lowerLeg =LowerLeg
   {left|right}_ankle @foot =Foot
    {left|right}_foot @toes =Toes
 spine1 @spine =spine
  spine2 @chest =chest
   spine3 @chest2 =upperChest
    neck @neck =neck
     head @head =head
    {left|right}_collar @clavicle =Shoulder
     {left|right}_shoulder @upperArm =UpperArm
      {left|right}_elbow @lowerArm =LowerArm
       {left|right}_wrist @hand =Hand
        {left|right}_hand @Middle1
"""
RIGS["smpl-x"] = (
    RIGS["smpl"]
    .replace(
        "     head @head =head\n",
        "     head @head =head\n      jaw @jaw =jaw\n      {left|right}_eye_smplhf @eye =Eye\n",
    )
    .replace(
        "        {left|right}_hand @Middle1\n",
        fingers(8, "{left|right}_N#", 3, {k: v.lower() for k, v in (FINGERS | dict(Little="pinky")).items()}) + "\n",
    )
)
_vroid_hand = fingers(9, "J_Bip_{L|R}_N#", 3)
RIGS["vroid"] = f"""
Root @ground
 J_Bip_C_Hips @hips =hips
  J_Bip_C_Spine @spine =spine
   J_Bip_C_Chest @chest =chest
    J_Bip_C_UpperChest @upperChest =upperChest
     J_Sec_{{L|R}}_Bust1 @breast
      J_Sec_{{L|R}}_Bust2 @breast~chest~-0.3
     J_Bip_C_Neck @neck =neck
      J_Bip_C_Head @head =head
       J_Adj_{{L|R}}_FaceEye @eye =Eye
       J_Sec_Hair1_01 @hair1
        J_Sec_Hair2_01 @hair2
         J_Sec_Hair3_01 @hair3
          J_Sec_Hair4_01 @hair4
       J_Sec_Hair1_{{02|03}} @tail1
        J_Sec_Hair2_{{02|03}} @tail2
         J_Sec_Hair3_{{02|03}} @tail3
          J_Sec_Hair4_{{02|03}} @tail4
     J_Bip_{{L|R}}_Shoulder @clavicle =Shoulder
      J_Bip_{{L|R}}_UpperArm @upperArm =UpperArm
       J_Sec_{{L|R}}_TipSleeve @upperArm~lowerArm~0.9
       J_Bip_{{L|R}}_LowerArm @lowerArm =LowerArm
        J_Bip_{{L|R}}_Hand @hand =Hand
{_vroid_hand}
  J_Bip_{{L|R}}_UpperLeg @upperLeg =UpperLeg
   J_Sec_{{L|R}}_SkirtFront1_01 @skirt1
    J_Sec_{{L|R}}_SkirtFront2_01 @skirt2
     J_Sec_{{L|R}}_SkirtFront3_01 @skirt3
      J_Sec_{{L|R}}_SkirtFront_end_01 @skirt4
   J_Bip_{{L|R}}_LowerLeg @lowerLeg =LowerLeg
    J_Bip_{{L|R}}_Foot @foot =Foot
     J_Bip_{{L|R}}_ToeBase @toes =Toes
"""
RIGS["xsens"] = """
Hips @hips =hips
 L5 @waist =spine
  L3 @spine
   T12 @spine2
    T8 @chest
     Neck @neck =neck
      Head @head =head
     {Left|Right}Shoulder @clavicle =Shoulder
      {Left|Right}UpperArm @upperArm =UpperArm
       {Left|Right}ForeArm @lowerArm =LowerArm
        {Left|Right}Hand @hand =Hand
 {Left|Right}UpperLeg @upperLeg =UpperLeg
  {Left|Right}LowerLeg @lowerLeg =LowerLeg
   {Left|Right}Foot @foot =Foot
    {Left|Right}Toe @toes =Toes
"""
RIGS["optitrack"] = """
Skeleton_001_Hip @hips =hips
 Skeleton_001_Ab @spine =spine
  Skeleton_001_Chest @chest =chest
   Skeleton_001_Neck @neck =neck
    Skeleton_001_Head @head =head
   Skeleton_001_{L|R}Shoulder @clavicle =Shoulder
    Skeleton_001_{L|R}UArm @upperArm =UpperArm
     Skeleton_001_{L|R}FArm @lowerArm =LowerArm
      Skeleton_001_{L|R}Hand @hand =Hand
 Skeleton_001_{L|R}Thigh @upperLeg =UpperLeg
  Skeleton_001_{L|R}Shin @lowerLeg =LowerLeg
   Skeleton_001_{L|R}Foot @foot =Foot
    Skeleton_001_{L|R}Toe @toes =Toes
"""
RIGS["roblox"] = """
HumanoidRootPart @hips
 LowerTorso @hips =hips
  UpperTorso @spine =spine
   Head @neck~head~0.3 =head
   {Left|Right}UpperArm @upperArm =UpperArm
    {Left|Right}LowerArm @lowerArm =LowerArm
     {Left|Right}Hand @hand =Hand
  {Left|Right}UpperLeg @upperLeg =UpperLeg
   {Left|Right}LowerLeg @lowerLeg =LowerLeg
    {Left|Right}Foot @foot =Foot
"""
RIGS["kinect"] = """
SpineBase @hips =hips
 SpineMid @spine2 =spine
  SpineShoulder @upperChest =chest
   Neck @neck =neck
    Head @head~headTop~0.4 =head
   Shoulder{Left|Right} @upperArm =UpperArm
    Elbow{Left|Right} @lowerArm =LowerArm
     Wrist{Left|Right} @hand =Hand
      Hand{Left|Right} @Middle1
       HandTip{Left|Right} @Middle4
      Thumb{Left|Right} @Thumb3
 Hip{Left|Right} @upperLeg =UpperLeg
  Knee{Left|Right} @lowerLeg =LowerLeg
   Ankle{Left|Right} @foot =Foot
    Foot{Left|Right} @toes =Toes
"""
RIGS["makehuman game"] = """
Root @ground
 pelvis @hips =hips
  spine_01 @spine =spine
   spine_02 @chest =chest
    spine_03 @upperChest =upperChest
     clavicle_{l|r} @clavicle =Shoulder
      upperarm_{l|r} @upperArm =UpperArm
       lowerarm_{l|r} @lowerArm =LowerArm
        hand_{l|r} @hand =Hand
     neck_01 @neck =neck
      head @head =head
  thigh_{l|r} @upperLeg =UpperLeg
   calf_{l|r} @lowerLeg =LowerLeg
    foot_{l|r} @foot =Foot
     ball_{l|r} @toes =Toes
"""
RIGS["mmd japanese"] = """
全ての親 @ground
 センター @hips~upperLeg~0.5
  グルーブ @hips~upperLeg~0.5
   腰 @hips =hips
    上半身 @waist =spine
     上半身2 @chest =chest
      首 @neck =neck
       頭 @head =head
        両目 @head~headTop~0.9
        {左|右}目 @eye =Eye
      {左|右}肩 @clavicle =Shoulder
       {左|右}腕 @upperArm =UpperArm
        {左|右}腕捩 @upperArm~lowerArm~0.6
         {左|右}ひじ @lowerArm =LowerArm
          {左|右}手捩 @lowerArm~hand~0.6
           {左|右}手首 @hand =Hand
    下半身 @hips
     {左|右}足 @upperLeg =UpperLeg
      {左|右}ひざ @lowerLeg =LowerLeg
       {左|右}足首 @foot =Foot
        {左|右}つま先 @toes =Toes
  {左|右}足IK @foot
   {左|右}つま先IK @toes
"""
RIGS["german"] = """
Wurzel @ground
 Becken @hips =hips
  Wirbelsäule @spine =spine
   Brust @chest2 =chest
    Hals @neck =neck
     Kopf @head =head
    Schlüsselbein_{links|rechts} @clavicle =Shoulder
     Oberarm_{links|rechts} @upperArm =UpperArm
      Unterarm_{links|rechts} @lowerArm =LowerArm
       Hand_{links|rechts} @hand =Hand
  Oberschenkel_{links|rechts} @upperLeg =UpperLeg
   Unterschenkel_{links|rechts} @lowerLeg =LowerLeg
    Fuß_{links|rechts} @foot =Foot
     Zehen_{links|rechts} @toes =Toes
"""
RIGS["french"] = """
racine @ground
 bassin @hips =hips
  colonne @spine =spine
   poitrine @chest2 =chest
    cou @neck =neck
     tête @head =head
    épaule {gauche|droite} @clavicle =Shoulder
     bras {gauche|droit} @upperArm =UpperArm
      avant-bras {gauche|droit} @lowerArm =LowerArm
       main {gauche|droite} @hand =Hand
  cuisse {gauche|droite} @upperLeg =UpperLeg
   mollet {gauche|droit} @lowerLeg =LowerLeg
    pied {gauche|droit} @foot =Foot
     orteils {gauche|droit} @toes =Toes
"""
RIGS["hungarian"] = """
gyökér @ground
 csípő @hips =hips
  gerinc @spine =spine
   mellkas @chest2 =chest
    nyak @neck =neck
     fej @head =head
    váll_{bal|jobb} @clavicle =Shoulder
     felkar_{bal|jobb} @upperArm =UpperArm
      alkar_{bal|jobb} @lowerArm =LowerArm
       kéz_{bal|jobb} @hand =Hand
  comb_{bal|jobb} @upperLeg =UpperLeg
   lábszár_{bal|jobb} @lowerLeg =LowerLeg
    lábfej_{bal|jobb} @foot =Foot
     lábujjak_{bal|jobb} @toes =Toes
"""
RIGS["no spine, no clavicles, no toes"] = """
Armature @ground
 pelvis @hips =hips
  torso @chest =spine
   skull @head =head
   bicep.{L|R} @upperArm =UpperArm
    elbow.{L|R} @lowerArm =LowerArm
     fist.{L|R} @hand =Hand
      sword.{L|R} @hand~lowerArm~-0.2
       sword_tip.{L|R} @hand~lowerArm~-4.0
  hip.{L|R} @upperLeg =UpperLeg
   knee.{L|R} @lowerLeg =LowerLeg
    ankle.{L|R} @foot =Foot
     foot_end.{L|R} @toes
 knee_pole.{L|R} @pole
 foot_ik.{L|R} @foot
"""
RIGS["maya rolls"] = """
Reference @ground
 Hips @hips =hips
  {Left|Right}UpLeg @upperLeg =UpperLeg
   {Left|Right}UpLegRoll @upperLeg~lowerLeg~0.5
   {Left|Right}Leg @lowerLeg =LowerLeg
    {Left|Right}LegRoll @lowerLeg~foot~0.5
    {Left|Right}Foot @foot =Foot
     {Left|Right}ToeBase @toes =Toes
  Spine @spine =spine
   Spine1 @chest =chest
    {Left|Right}Shoulder @clavicle =Shoulder
     {Left|Right}Arm @upperArm =UpperArm
      {Left|Right}ArmRoll @upperArm~lowerArm~0.5
      {Left|Right}ForeArm @lowerArm =LowerArm
       {Left|Right}ForeArmRoll @lowerArm~hand~0.5
       {Left|Right}Hand @hand =Hand
    Neck @neck =neck
     Head @head =head
"""


def rig(name: str, places: dict[str, tuple[float, float, float]] | None = None) -> tuple[Skeleton, dict[str, str]]:
    """The skeleton of one rig in a T pose and its truth: canonical name to joint name."""
    places = {key: np.array(value, dtype=float) for key, value in (places or PLACES).items()}
    names, parents, points, truth = [], [], [], {}
    stack: list[tuple[int, tuple[int, int]]] = []
    for line in RIGS[name].strip("\n").splitlines():
        indent = len(line) - len(line.lstrip(" "))
        label, _, rest = line.strip().partition(" @")
        place, _, canonical = rest.partition(" =")
        while stack and stack[-1][0] >= indent:
            stack.pop()
        above = stack[-1][1] if stack else (-1, -1)
        sided, made = "{" in label, []
        for side, word in enumerate(("left", "right") if sided else ("",)):
            made.append(len(names))
            names.append(re.sub(r"\{([^|}]*)\|([^}]*)\}", rf"\{side + 1}", label))
            parents.append(above[side])
            point = _place(places, place)
            points.append(point * np.array([-1.0, 1.0, 1.0]) if side else point)
            if canonical:
                truth[word + canonical if sided else canonical] = names[-1]
        stack.append((indent, (made[0], made[-1])))
    return skeleton_of(names, parents, np.array(points)), truth


def _place(places: dict, text: str) -> np.ndarray:
    if "~" not in text:
        return places[text.strip()]
    a, b, t = text.split("~")
    return places[a] + (places[b] - places[a]) * float(t)


def skeleton_of(names: list[str], parents: list[int], points: np.ndarray) -> Skeleton:
    """A skeleton with the joints at these world positions, parents first, no rest rotations."""
    parents = np.array(parents)
    order = sorted(range(len(names)), key=lambda joint: (_depth(parents, joint), joint))
    new = {old: i for i, old in enumerate(order)}
    offsets = np.where(parents[:, None] >= 0, points - points[parents], points)[order]
    return Skeleton(
        tuple(names[old] for old in order),
        np.array([new.get(int(parents[old]), -1) for old in order]),
        offsets,
        np.tile([0.0, 0.0, 0.0, 1.0], (len(names), 1)),
    )


def _depth(parents: np.ndarray, joint: int) -> int:
    depth = 0
    while parents[joint] >= 0:
        joint, depth = int(parents[joint]), depth + 1
    return depth


def child_places(legs: float = 1.0, arms: float = 1.0, head: float = 1.0) -> dict[str, tuple[float, float, float]]:
    """Other proportions: legs and arms scaled about hips and shoulders, the head about the neck."""
    changed = {}
    for key, value in PLACES.items():
        p = np.array(value, dtype=float)
        if key in ("upperLeg", "lowerLeg", "foot", "toes", "toeEnd", "heel"):
            hip = np.array(PLACES["upperLeg"])
            p = hip + (p - hip) * legs
        elif key in ("lowerArm", "hand") or key[:-1] in FINGER_ROWS:
            shoulder = np.array(PLACES["upperArm"])
            p = shoulder + (p - shoulder) * arms
        elif key in ("headTop", "eye", "jawTip"):
            p = np.array(PLACES["head"]) + (p - np.array(PLACES["head"])) * head
        changed[key] = tuple(p)
    return changed


def posed(skeleton: Skeleton, turns: dict[str, tuple[float, float, float]], truth: dict[str, str]) -> Skeleton:
    """Another rest pose: canonical joint to a rotation vector in degrees, about world axes."""
    rotations = skeleton.rest_rotations.copy()
    for canonical, degrees in turns.items():
        rotations[skeleton.index(truth[canonical])] = rot.from_rotation_vector(
            np.radians(np.array(degrees, dtype=float))
        )
    return Skeleton(skeleton.names, skeleton.parents, skeleton.offsets, rotations, skeleton.end_offsets)


POSES = {
    "T": {},
    "A": {"leftUpperArm": (0, 0, -45), "rightUpperArm": (0, 0, 45)},
    "I": {
        "leftUpperArm": (0, 0, -85),
        "rightUpperArm": (0, 0, 85),
        "leftLowerArm": (0, -10, 0),
        "rightLowerArm": (0, 10, 0),
    },
    "arms up": {"leftUpperArm": (0, 0, 75), "rightUpperArm": (0, 0, -75)},
    "legs apart": {
        "leftUpperLeg": (0, 0, 30),
        "rightUpperLeg": (0, 0, -30),
        "leftUpperArm": (0, 0, -20),
        "rightUpperArm": (0, 0, 20),
    },
    "step": {
        "leftUpperLeg": (-30, 0, 0),
        "rightUpperLeg": (20, 0, 0),
        "rightLowerLeg": (25, 0, 0),
        "leftUpperArm": (0, 0, -70),
        "rightUpperArm": (0, 0, 70),
        "leftLowerArm": (0, -60, 0),
        "spine": (8, 10, 0),
    },
    "sitting": {
        "leftUpperLeg": (-80, 0, 0),
        "rightUpperLeg": (-80, 0, 0),
        "leftLowerLeg": (80, 0, 0),
        "rightLowerLeg": (80, 0, 0),
        "leftUpperArm": (0, 0, -60),
        "rightUpperArm": (0, 0, 60),
    },
    "guard": {
        "leftUpperArm": (0, -50, -40),
        "rightUpperArm": (0, 50, 40),
        "leftLowerArm": (0, -70, 0),
        "rightLowerArm": (0, 70, 0),
        "leftUpperLeg": (-15, 0, 8),
        "rightUpperLeg": (-15, 0, -8),
        "leftLowerLeg": (30, 0, 0),
        "rightLowerLeg": (30, 0, 0),
    },
}


def moved(skeleton: Skeleton, rotation: np.ndarray, scale: float, shift: np.ndarray) -> Skeleton:
    """The same body elsewhere: turned (quaternion), scaled, moved, as files in other axes and units hold it."""
    offsets, rotations = skeleton.offsets * scale, skeleton.rest_rotations.copy()
    offsets[0] = rot.rotate(rotation, offsets[0]) + shift
    rotations[0] = rot.multiply(rotation, rotations[0])
    ends = skeleton.end_offsets and {joint: end * scale for joint, end in skeleton.end_offsets.items()}
    return Skeleton(skeleton.names, skeleton.parents, offsets, rotations, ends)


def mirrored(skeleton: Skeleton) -> Skeleton:
    """The body in a mirror (x to -x), names as they were."""
    rotations, positions = rest_pose(skeleton)
    return skeleton_of(list(skeleton.names), list(skeleton.parents), positions * np.array([-1.0, 1.0, 1.0]))


def reordered(skeleton: Skeleton, seed: int) -> Skeleton:
    """Joints in another order, parents still first."""
    rng, left, order = np.random.default_rng(seed), [0], []
    while left:
        joint = left.pop(int(rng.integers(len(left))))
        order.append(joint)
        left.extend(skeleton.children(joint))
    new = {old: i for i, old in enumerate(order)}
    ends = skeleton.end_offsets and {new[joint]: end for joint, end in skeleton.end_offsets.items()}
    return Skeleton(
        tuple(skeleton.names[old] for old in order),
        np.array([new.get(int(skeleton.parents[old]), -1) for old in order]),
        skeleton.offsets[order],
        skeleton.rest_rotations[order],
        ends,
    )


def renamed(skeleton: Skeleton, changes: dict[str, str]) -> Skeleton:
    names = tuple(changes.get(name, name) for name in skeleton.names)
    return Skeleton(names, skeleton.parents, skeleton.offsets, skeleton.rest_rotations, skeleton.end_offsets)


def with_helper(skeleton: Skeleton, joint: str, share: float = 0.0, name: str = "helper") -> Skeleton:
    """One more joint on the bone above `joint`, at a share of its length."""
    rotations, positions = rest_pose(skeleton)
    below, above = skeleton.index(joint), int(skeleton.parents[skeleton.index(joint)])
    names, parents = [*skeleton.names, name], [*skeleton.parents, above]
    parents[below] = len(skeleton)
    helper = positions[above] + share * (positions[below] - positions[above])
    return skeleton_of(names, parents, np.concatenate([positions, helper[None]]))


def without(skeleton: Skeleton, joint: str) -> Skeleton:
    """The skeleton without a joint; its children hang on its parent."""
    rotations, positions = rest_pose(skeleton)
    gone = skeleton.index(joint)
    parents = [int(skeleton.parents[gone]) if parent == gone else int(parent) for parent in skeleton.parents]
    keep = [i for i in range(len(skeleton)) if i != gone]
    new = {old: i for i, old in enumerate(keep)}
    return skeleton_of([skeleton.names[i] for i in keep], [new.get(parents[i], -1) for i in keep], positions[keep])
