"""What networks see of an observation, by hand."""

import torch

from morlnav.navigation.modules import NavigationFeatures


def test_features_may_leave_the_lidar_out():
    observation = torch.rand(5, 34)
    blind = observation.clone()
    blind[:, 4:] = 4.0
    features = NavigationFeatures(use_lidar=False)
    assert torch.equal(features(observation), features(blind))
    assert not torch.equal(NavigationFeatures()(observation), NavigationFeatures()(blind))


def test_octaves_are_waves_of_the_distances():
    observation = torch.zeros(1, 34)
    observation[:, 0], observation[:, 2] = 8.0, 1.0
    features = NavigationFeatures(use_lidar=False, octaves=4)(observation)[0]
    goal, human = features[4:12], features[16:24]
    wave = torch.pi * torch.tensor([1.0, 2.0, 4.0, 8.0])  # wavelengths 16, 8, 4 and 2 m
    torch.testing.assert_close(goal, torch.cat([wave.sin(), wave.cos()]), atol=1e-5, rtol=0)
    torch.testing.assert_close(human, torch.cat([(wave / 8).sin(), (wave / 8).cos()]), atol=1e-5, rtol=0)
