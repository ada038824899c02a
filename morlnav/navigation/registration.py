"""Importing this registers the environment with Gymnasium; nothing of it is imported before somebody makes one.

Gymnasium 1 looks for no plugins, so it has to be imported: by ``import gymnasium, morlnav``, in this order, with
:mod:`morlnav.navigation.envs`, or as ``gymnasium.make("morlnav.navigation.envs:morlnav/SocialNavigation-v0")``.
"""

from gymnasium import register

ENV_ID = "morlnav/SocialNavigation-v0"
MAX_EPISODE_STEPS = 250

register(
    ENV_ID,
    entry_point="morlnav.navigation.envs:SocialNavigation",  # as text, for a spec is kept as JSON
    vector_entry_point="morlnav.navigation.envs:SocialNavigationVector",
    max_episode_steps=MAX_EPISODE_STEPS,
    disable_env_checker=True,  # it asks for a scalar reward
)
