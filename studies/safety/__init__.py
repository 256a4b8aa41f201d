"""What protection does and does not prevent, in lockstep, with MuJoCo's contacts as the judge."""
