"""Every figure of the benches in one sentence: what `retarget bench --help` prints. Imports nothing."""

FORMULAS = {
    "match_rate": "share of skeletons whose required humanoid joints (those of VRM's 15 that they have) are all right by the truth file",
    "match_rate_scrambled": "the same after every joint name was replaced by random letters",
    "direction_error_deg": "angle between source and target bone, upper and lower arms and legs, foot lock off; mean over frames, limbs, clips and characters",
    "orientation_error_deg": "angle between source and target palm normal (knuckle row x hand direction), sole normal, foot heading, face direction and line of the eyes, those that both bodies show, foot lock off; mean",
    "foot_slide_cm": "per contact of heel or ball in the source: largest horizontal distance of the target's point from its mean place over the contact; mean over contacts, cm at 1.7 m",
    "floor_error_cm": "frames with contact: |height of the lowest resting point over its support|; mean, cm at 1.7 m",
    "foot_slide_wide_cm": "the same over contacts by wider thresholds than those the method holds by (more of landing and leaving)",
    "source_slide_wide_cm": "the source's own slide over those contacts, cm at 1.7 m",
    "jerk_ratio": "mean |third difference| of hips, head, hands and feet at 30 frames/s over leg length, target over source; mean over cases",
    "lower_jerk_ratio": "the same of hips and feet alone",
    "upper_jerk_ratio": "the same of head and hands alone, over body height (a leg length charges short legs for long arms)",
    "..._worst": "the worst single case of the figure before it",
    "round_trip_mm": "largest joint displacement after writing and reading back, over formats and clips",
    "two_skeletons_cm": "one performance captured on two skeletons, both retargeted onto one character: mean distance of the required joints after aligning the first frame's hips, cm at 1.7 m",
    "help_seconds": "wall time of `retarget --help`, median of 5",
    "import_seconds": "wall time of `import retarget` in a fresh interpreter, median of 5",
    "command_seconds": "wall time of a whole `retarget run` of a 2,752-frame BVH onto a 41-joint glTF character",
    "solve_frames_per_second": "frames a second of the prepared retargeter on that clip, best of 3, foot lock on",
}
