"""The paper's figures as data: families × arms × seeds; their pictures and reports."""
