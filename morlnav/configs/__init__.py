"""Hydra configs of every part, in TorchRL's config groups; importing this package registers them.

Each config has a field for every argument of its constructor, with the same default. TorchRL's own configs are
registered along.

Examples:
    >>> from hydra import compose, initialize
    >>> from hydra.utils import instantiate
    >>> with initialize(version_base=None):
    ...     cfg = compose(overrides=["+env=social_navigation", "env.num_envs=4", "+world@env.world=pymunk_world"])
    >>> type(instantiate(cfg.env).world).__name__
    'PymunkWorld'
"""

from morlnav.configs.common import CONFIGS, PartConfig, store
from morlnav.configs.data import (
    CornerWeightedPreferencesConfig,
    DirichletPreferencesConfig,
    FixedPreferencesConfig,
    GridPreferencesConfig,
    SegmentedPreferencesConfig,
    UniformPreferencesConfig,
)
from morlnav.configs.envs import (
    CollisionConfig,
    DemonstrationObjectiveConfig,
    DifferentialDriveConfig,
    EfficiencyConfig,
    GoalProgressConfig,
    HumanDistanceConfig,
    LidarConfig,
    NavigationEnvConfig,
    PymunkWorldConfig,
    SceneSamplerConfig,
    SumConfig,
    TensorWorldConfig,
)
from morlnav.configs.hooks import (
    AnnealDiscountConfig,
    EvaluatePolicyConfig,
    FitInterpolatorConfig,
    LogEpisodesConfig,
    LogOptimisationConfig,
    MORLTD3StepperConfig,
    StepExplorationConfig,
    StopDivergenceConfig,
)
from morlnav.configs.modules import (
    ActorConfig,
    AfterstateFeaturesConfig,
    CircumnavigationOracleConfig,
    EpsilonGreedyNoiseConfig,
    NavigationFeaturesConfig,
    NoiseModelConfig,
    NormalisedRewardConfig,
    PartlyGreedyNoiseConfig,
    PassingOracleConfig,
    PreferenceActorModelConfig,
    PreferenceInterpolatorConfig,
    RewardEnsembleConfig,
    RewardFileConfig,
    RewardModelConfig,
    SlowPassingOracleConfig,
    UniformActionsConfig,
    VectorCriticConfig,
    VectorCriticModelConfig,
    WaitingOracleConfig,
    WanderingNoiseConfig,
)
from morlnav.configs.objectives import (
    AngleTermConfig,
    BehaviourCloningLossConfig,
    ClampedAngleTermConfig,
    GuidanceConfig,
    LinearScalarisationConfig,
    MORLTD3LossConfig,
    RankingLossConfig,
)
from morlnav.configs.transforms import DemonstrationRewardConfig, DrawPreferenceConfig, HindsightPreferenceRelabelConfig

__all__ = [
    "CONFIGS",
    "ActorConfig",
    "AfterstateFeaturesConfig",
    "AngleTermConfig",
    "AnnealDiscountConfig",
    "BehaviourCloningLossConfig",
    "CircumnavigationOracleConfig",
    "ClampedAngleTermConfig",
    "CollisionConfig",
    "CornerWeightedPreferencesConfig",
    "DemonstrationObjectiveConfig",
    "DemonstrationRewardConfig",
    "DifferentialDriveConfig",
    "DirichletPreferencesConfig",
    "DrawPreferenceConfig",
    "EfficiencyConfig",
    "EpsilonGreedyNoiseConfig",
    "EvaluatePolicyConfig",
    "FitInterpolatorConfig",
    "FixedPreferencesConfig",
    "GoalProgressConfig",
    "GridPreferencesConfig",
    "GuidanceConfig",
    "HindsightPreferenceRelabelConfig",
    "HumanDistanceConfig",
    "LidarConfig",
    "LinearScalarisationConfig",
    "LogEpisodesConfig",
    "LogOptimisationConfig",
    "MORLTD3LossConfig",
    "MORLTD3StepperConfig",
    "NavigationEnvConfig",
    "NavigationFeaturesConfig",
    "NoiseModelConfig",
    "NormalisedRewardConfig",
    "PartConfig",
    "PartlyGreedyNoiseConfig",
    "PassingOracleConfig",
    "PreferenceActorModelConfig",
    "PreferenceInterpolatorConfig",
    "PymunkWorldConfig",
    "RankingLossConfig",
    "RewardEnsembleConfig",
    "RewardFileConfig",
    "RewardModelConfig",
    "SceneSamplerConfig",
    "SegmentedPreferencesConfig",
    "SlowPassingOracleConfig",
    "StepExplorationConfig",
    "StopDivergenceConfig",
    "SumConfig",
    "TensorWorldConfig",
    "UniformActionsConfig",
    "UniformPreferencesConfig",
    "VectorCriticConfig",
    "VectorCriticModelConfig",
    "WaitingOracleConfig",
    "WanderingNoiseConfig",
    "store",
]
