"""A stand-in for lerobot.processor: the methods that a step must have, and the pipeline's check of its class."""

from abc import ABC, abstractmethod


class ProcessorStep(ABC):
    _current_transition = None

    @property
    def transition(self):
        if self._current_transition is None:
            raise ValueError("no transition yet")
        return self._current_transition

    @abstractmethod
    def __call__(self, transition):
        ...

    @abstractmethod
    def transform_features(self, features):
        ...

    def get_config(self):
        return {}

    def state_dict(self):
        return {}

    def load_state_dict(self, state):
        pass

    def save_artifacts(self, save_directory):
        return {}

    def reset(self):
        pass


class Pipeline:
    """Takes a pair (action, observation), like LeRobot's pipeline for a robot's actions, and rejects other steps."""

    def __init__(self, steps):
        for step in steps:
            if not isinstance(step, ProcessorStep):
                raise TypeError(f"{type(step).__name__} is no ProcessorStep")
        self.steps = steps

    def reset(self):
        for step in self.steps:
            step.reset()

    def __call__(self, pair):
        action, observation = pair
        transition = {"observation": observation, "action": action, "reward": 0.0, "done": False,
                      "truncated": False, "info": {}, "complementary_data": {}}
        for step in self.steps:
            transition = step(transition)
        return transition
