"""Learners of one task: DQN and DDPG, adaptation with the advantage head, MAML fine-tuning."""
