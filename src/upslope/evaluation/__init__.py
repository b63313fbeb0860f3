"""What a prior is worth: what its policy and its potential show on fresh tasks, a test with learners, a verdict."""
