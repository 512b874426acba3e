"""Who may say what: certificates, names and the access rules made from the topics table."""
