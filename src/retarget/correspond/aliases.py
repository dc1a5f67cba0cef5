"""How people call the joints of a human: the one alias table.

A name is compared after `joints_by_name.spell` has taken away namespaces, sides, digits, separators and case, so that
'mixamorig:LeftForeArm', 'J_Bip_L_LowerArm' and 'lowerarm_l' become 'forearm' and 'lowerarm'. Parts are the VRM 1.0
humanoid joints without their side; a finger is one part, its joints are counted along the bone chain.
"""

from __future__ import annotations

CENTRAL_PARTS = ("hips", "spine", "chest", "upperChest", "neck", "head", "jaw")
SIDED_PARTS = ("UpperLeg", "LowerLeg", "Foot", "Toes", "Shoulder", "UpperArm", "LowerArm", "Hand", "Eye")
FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")

ALIASES: dict[str, str] = {
    # Mixamo, HumanIK, Unreal, Rigify, Biped, Daz, Poser, SMPL, MakeHuman, VRM, Quaternius, KayKit, Xsens, OptiTrack,
    # MMD; then German, French, Spanish, Italian, Japanese, Chinese.
    "hips": "hips pelvis hip lowertorso bassin becken huefte cadera bacino 腰 下半身 骨盆 臀",
    "spine": "spine abdomen abdomenlower spinelower lowerback waist lowerspine torso lowerabdomen stomach belly "
    "ab torse wirbelsaeule ruecken columna 上半身 脊椎 背骨",
    "chest": "chest spinemid abdomenupper upperabdomen chestlower lowerchest thorax uppertorso upperback brust "
    "pecho poitrine torace spineupper 胸 胸部",
    "upperChest": "upperchest chestupper upperspine brustoben 上胸",
    "neck": "neck necklower lowerneck cou hals cuello collo 首 脖子 颈 頸",
    "head": "head skull tete kopf cabeza testa cabeca 頭 头",
    "jaw": "jaw lowerjaw jawroot jawbone chin mandible jawlower 下颌",
    "UpperLeg": "upperleg upleg thigh femur thighbend legupper uplegs cuisse oberschenkel muslo coscia uppleg 足 "
    "大腿 太もも",
    "LowerLeg": "lowerleg loleg shin calf knee crus tibia leglower lowleg shinbend shank lowerlegs downleg "
    "mollet genou unterschenkel knie rodilla pantorrilla ginocchio ひざ 膝 小腿",
    "Foot": "foot ankle feet fuss pied cheville pie tobillo piede caviglia legfoot 足首 脚 脚踝 脚腕",
    "Toes": "toes toe toebase ball forefoot toeball metatarsals balltoe orteil orteils zehen zeh dedos punta "
    "つま先 足先 爪先 脚趾 脚尖",
    "Shoulder": "shoulder clavicle collar clavicula collarbone clav scapula epaule clavicule schulter "
    "schluesselbein hombro spalla 肩 锁骨 鎖骨",
    "UpperArm": "upperarm uparm uarm armupper shldr shldrbend humerus bicep bras oberarm brazo uppararm 腕 上腕 "
    "上臂 大臂",
    "LowerArm": "lowerarm loarm farm forearm elbow armlower forearmbend ulna radius lowarm avantbras coude "
    "unterarm ellbogen codo antebrazo gomito avambraccio ひじ 肘 前腕 前臂 小臂",
    "Hand": "hand wrist palm handbase main poignet handgelenk mano muneca polso 手首 手 手腕",
    "Eye": "eye eyeball oeil auge ojo occhio faceeye 目 眼 眼睛",
    "Thumb": "thumb pouce daumen pulgar pollice 親指 拇指",
    "Index": "index indexfinger findex pointer zeigefinger indice 人指 食指 人差指",
    "Middle": "middle mid middlefinger fmiddle majeur mittelfinger medio 中指",
    "Ring": "ring ringfinger fring annulaire ringfinger anular anulare 薬指 无名指 無名指",
    "Little": "little pinky pinkie pinkyfinger littlefinger fpinky auriculaire kleinerfinger menique mignolo 小指",
}
"""Words that mean this part and hardly ever another."""

AMBIGUOUS: dict[str, dict[str, float]] = {
    "hip": {"hips": 0.9, "UpperLeg": 0.9},  # with a side it is the thigh (SMPL, OptiTrack), without one the pelvis
    "shoulder": {"Shoulder": 0.8, "UpperArm": 0.6},  # Mixamo against SMPL and Poser
    "arm": {"UpperArm": 0.8, "LowerArm": 0.2},
    "leg": {"LowerLeg": 0.7, "UpperLeg": 0.5},
    "jambe": {"LowerLeg": 0.6, "UpperLeg": 0.6},
    "bein": {"LowerLeg": 0.5, "UpperLeg": 0.6},
    "pierna": {"LowerLeg": 0.6, "UpperLeg": 0.6},
    "gamba": {"LowerLeg": 0.6, "UpperLeg": 0.6},
    "braccio": {"UpperArm": 0.8, "LowerArm": 0.2},
    "torso": {"spine": 0.8, "chest": 0.7},
    "body": {"hips": 0.4, "spine": 0.4},
    "root": {"hips": 0.2},
    "cog": {"hips": 0.3},
    "wrist": {"Hand": 0.9},
    "palm": {"Hand": 0.8},
}
"""Words that mean one of several parts, with how readily; they take precedence over the table above."""

LEFT = (
    "l left lft lf gauche links linke linker linkes izquierda izquierdo izq sinistra sinistro sx esquerda esquerdo 左"
)
RIGHT = "r right rgt rt droit droite rechts rechte rechter rechtes derecha derecho destra destro dx direita direito 右"
SIDES: dict[str, int] = {**dict.fromkeys(LEFT.split(), 1), **dict.fromkeys(RIGHT.split(), -1)}
"""Side markers: +1 left, -1 right."""

NOISE = frozenset(
    "bone bones jnt joint jt bn bip biped def org mixamorig rig cc base j adj smplhf sk skel skeleton armature "
    "valvebiped valve character avatar player genesis c center centre ctr m sec actor human humanoid bind bnd "
    "drv deform fbx".split()
)
"""Words that say nothing about the part."""

AUXILIARY = frozenset(
    "ik fk pole target ctrl control controller end nub tip leaf site effector eff goal handle mch helper adjust "
    "slot prop weapon sword shield gun hair skirt cape tail wing ear ears breast bust boob cloth dress sleeve "
    "ribbon tie socket attach lookat jiggle phys physics dyn dynamic corrective vis tweak switch widget wgt "
    "gizmo locator hook hat antenna poles heelik tongue lip brow lash eyelid lid cheek nose teeth mouth pagne "
    "arme waffe arma accessory bag belt holster toeroll heelroll heel ponytail twintail bang bangs scarf strap "
    "pouch ikfoot iktoe 捩 先 髪 スカート".split()
)
"""Words of joints that drive, end, dress or equip a body but are none of its joints."""

TWISTS = frozenset("twist roll twst tws tw rolls torsion 捩".split())
"""Words of joints that share the turn of a limb segment about its own length."""

FOREIGN = frozenset(
    "wing wings hoof hooves paw paws foreleg forelegs frontleg hindleg rearleg backleg fin fins tentacle "
    "flipper pincer feather feathers hock fetlock pastern muzzle beak mandibles pedipalp".split()
)
"""Words of limbs that no human has."""

ANIMAL = FOREIGN | frozenset("tail tails mane snout withers horn horns rump croup".split())
"""Words that, on a body whose trunk lies across its legs, mean an animal."""

METACARPALS = frozenset("metacarpal palm inhand carpal meta".split())
"""Words of the bones between wrist and knuckles."""
